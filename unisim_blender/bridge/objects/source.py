"""The recorded drive that a Blender scene was imported from, opened again whenever it is needed.

It is the float64 original that edits are told from. Opening takes a second, so the newest one is kept.
"""

from __future__ import annotations

import bpy

from ...editing.sampled.source import DriveSource, NotImported, open_source
from .imported import has_drive


def source_of(scene: bpy.types.Scene) -> DriveSource:
    """The source of a Blender scene. Raises `NotImported` where nothing was imported into it."""
    about = scene.unisim
    if not has_drive(scene):
        raise NotImported(f'scene "{scene.name}": no drive was imported into it: File > Import > Driving Log')
    return open_source(bpy.path.abspath(about.log), bpy.path.abspath(about.scene) if about.scene else "")
