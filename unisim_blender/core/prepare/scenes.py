"""Trained scenes that a drive is rendered with, by their folders. Nothing here renders."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from ..model.scene_file import HEADER_NAME, WEIGHTS_NAME
from ..world.drive import Drive


def other_scenes(drive: Drive) -> tuple[str, ...]:
    """Folders of the trained scenes that actors were inserted from."""
    return tuple(sorted({actor.look.scene for actor in drive.actors.values()} - {""}))


def stamp(scene: Path) -> tuple[Any, ...]:
    """What changes when a trained scene is written anew. A digest would take longer than an image of the view."""
    files = [scene / name for name in (HEADER_NAME, WEIGHTS_NAME)]
    return scene, *((file.stat().st_mtime_ns, file.stat().st_size) if file.is_file() else None for file in files)
