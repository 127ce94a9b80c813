"""The trained scenes that Blender's process has opened."""

from __future__ import annotations

from ...core.scenes.scene import OpenScenes

OPENED = OpenScenes()
scene_actors = OPENED.actors
"""Gives the actors of the scene in a folder, as edits ask for them."""
