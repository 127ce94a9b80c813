"""The street that a drive goes through, with the streets that its inserted actors come from."""

from __future__ import annotations

from pathlib import Path

from unisim_street.street import Street, load_street

from ..model.files.scene_file import read_scene_header
from ..world.drive import Drive
from .scenes import other_scenes


def street_of(street: Street, drive: Drive) -> Street:
    """The street with those of the scenes that the drive's actors were inserted from. Raises `UnisimError`."""
    for scene in other_scenes(drive):
        street = street.with_scene(scene, load_street(read_scene_header(Path(scene)).log_path))
    return street
