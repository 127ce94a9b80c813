"""What a scenario asks for and the method that a scene was trained by cannot give, in sentences."""

from __future__ import annotations

from pathlib import Path

from ..drive import Drive
from ..fields.config import ModelConfig
from ..scene_file import read_scene_header

SHOWN = 5
"""So many actors are named."""


def warnings(scene: Path, recorded: Drive, edited: Drive, sweeps: bool) -> list[str]:
    """One sentence for each thing that comes out otherwise than asked; ``sweeps`` says whether any are wanted. Raises
    `SceneError`."""
    header, found = read_scene_header(scene), []
    touched = [uid for uid in recorded.actors if edited.actors.get(uid) is not recorded.actors[uid]]
    added = [uid for uid, a in edited.actors.items() if uid not in recorded.actors and not a.look.scene and not a.look.mesh]
    if ModelConfig.from_dict(header.model).actors == "none" and (touched or added):
        every = [*touched, *added]
        names = ", ".join(every[:SHOWN]) + (f" and {len(every) - SHOWN} more" if len(every) > SHOWN else "")
        found.append(
            f"scene {header.name!r} is one field without actors: edits of {names} change labels, but no picture or sweep"
        )
    if sweeps and "lidar" in header.training.get("without", ()):
        found.append(f"scene {header.name!r} was trained without LiDAR: the intensities and drops of its sweeps mean nothing")
    return found
