"""Capability check: what a scenario asks for and the method that a scene was trained by cannot give, in sentences."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from ..model.config import ModelConfig
from ..model.files.scene_file import read_scene_header
from ..world.drive import Drive
from .scenes import stamp

SHOWN = 5
"""So many actors are named."""


class _Method(NamedTuple):
    """What a scene's training left it without."""

    name: str
    has_actors: bool
    has_lidar: bool


def capability_warnings(scene: Path, recorded: Drive, edited: Drive, sweeps: bool) -> list[str]:
    """One sentence for each thing that comes out otherwise than asked; ``sweeps`` says whether any are wanted. Raises
    `SceneError`."""
    method, found = _method(stamp(scene)), []
    changed = [uid for uid in recorded.actors if edited.actors.get(uid) is not recorded.actors[uid]]
    added = [
        uid
        for uid, a in edited.actors.items()
        if uid not in recorded.actors and not a.appearance.scene and not a.appearance.mesh
    ]
    if not method.has_actors and (changed or added):
        every = [*changed, *added]
        names = ", ".join(every[:SHOWN]) + (f" and {len(every) - SHOWN} more" if len(every) > SHOWN else "")
        found.append(
            f"scene {method.name!r} is one field without actors: edits of {names} change labels, but no image or sweep"
        )
    if sweeps and not method.has_lidar:
        found.append(
            f"scene {method.name!r} was trained without LiDAR: the intensities and drops of its sweeps mean nothing"
        )
    return found


@lru_cache(maxsize=16)
def _method(stamped: tuple[Any, ...]) -> _Method:
    """Of the scene that a stamp is of: its header need not be read for every image of a view."""
    header = read_scene_header(stamped[0])
    actors = ModelConfig.from_dict(header.model).actors
    return _Method(header.name, actors != "none", "lidar" not in header.training.get("without", ()))
