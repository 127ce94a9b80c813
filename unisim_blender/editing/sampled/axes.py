"""The axes in which displacements of actors are given: forward, left, up."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray
from ...core.world.classes import motion_of
from ...core.world.drive import Drive


def axes_of(label: str, place: FloatArray, drive: Drive) -> FloatArray | None:
    """Return the axes (3, 3) for an actor of a class at a place (3,); None for its own.

    What stands where it is, as cones do, has no front. Its axes are level ones of the recorded ego vehicle where that
    passes it nearest.
    """
    if motion_of(label) != "still":
        return None
    ego = drive.world_from_ego
    nearest = int(np.linalg.norm((ego.positions - place)[:, :2], axis=1).argmin())
    ahead = ego.at(ego.times_s[nearest])[:2, 0]
    cos, sin = ahead / np.linalg.norm(ahead)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
