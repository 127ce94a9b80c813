"""The beams of a standing LiDAR's sweep that may measure something else than in its last one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ...geometry import BoolArray
from ...sensors.rays import Rays
from ...world.drive import Actor
from ..visibility import Reach
from .changes import Changed


def dirty_beams(
    changed: Sequence[Changed], rays: Rays, reach: Reach, overhang_m: Callable[[Actor], float]
) -> BoolArray:
    """Return which rays (B, C), from one place, pass through what the boxes of actors that changed cover while they sweep."""
    dirty = np.zeros(rays.time_s.shape, bool)
    origin, directions, flat = rays.origins[0, 0], rays.directions.reshape(-1, 3), dirty.reshape(-1)
    for one in changed:
        pose, size = one.bounds(reach, overhang_m(one.actor))
        to = pose[:3, 3] - origin
        distance, radius = float(np.linalg.norm(to)), float(np.linalg.norm(size)) / 2
        near = np.arange(len(flat))
        if distance > radius:  # most rays are beside the cone about its sphere
            near = np.flatnonzero(directions @ (to / distance) >= np.sqrt(1 - (radius / distance) ** 2) - 1e-9)
        near = near[~flat[near]]
        inward, start = directions[near] @ pose[:3, :3], -to @ pose[:3, :3]
        safe = np.where(np.abs(inward) < 1e-12, 1e-12, inward)
        a, b = (-size / 2 - start) / safe, (size / 2 - start) / safe
        enter, leave = np.minimum(a, b).max(1), np.maximum(a, b).min(1)
        flat[near] = (enter <= leave) & (leave > 0)
    return dirty
