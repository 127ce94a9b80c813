"""Capability check: what a scenario asks for and the method that a scene was trained by cannot give, in sentences."""

from __future__ import annotations

from ..scenes.scene import Scene
from ..world.drive import Drive

SHOWN = 5
"""Largest number of actors that are named."""


def capability_warnings(scene: Scene, recorded: Drive, edited: Drive, sweeps: bool) -> list[str]:
    """Return one sentence for each thing that comes out otherwise than asked; ``sweeps`` says whether any are wanted."""
    name, warnings = scene.header.name, []
    changed = [uid for uid in recorded.actors if edited.actors.get(uid) is not recorded.actors[uid]]
    added = [
        uid
        for uid, a in edited.actors.items()
        if uid not in recorded.actors and not a.appearance.scene and not a.appearance.mesh
    ]
    if not scene.has_actors and (changed or added):
        every = [*changed, *added]
        names = ", ".join(every[:SHOWN]) + (f" and {len(every) - SHOWN} more" if len(every) > SHOWN else "")
        warnings.append(
            f"scene {name!r} is one field without actors: edits of {names} change labels, but no image or sweep"
        )
    if sweeps and not scene.has_lidar:
        warnings.append(
            f"scene {name!r} was trained without LiDAR: the intensities and drops of its sweeps mean nothing"
        )
    return warnings
