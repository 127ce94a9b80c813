"""The street that a drive goes through, with the streets that its inserted actors come from."""

from __future__ import annotations

from pathlib import Path

from unisim_blender.core.scenes.scene import open_scene, other_scenes
from unisim_blender.core.world.drive import Drive

from .street import Street, load_street


def street_of(street: Street, drive: Drive) -> Street:
    """The street with those of the scenes that the drive's actors were inserted from. Raises `UnisimError`."""
    for scene in other_scenes(drive):
        street = street.with_scene(scene, load_street(open_scene(Path(scene)).header.log_path))
    return street
