"""How bright a mesh is in a recorded image: as the ground beside it is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..geometry import FloatArray
from ..world.drive import Actor

PROBES = 32
RING = 1.15
"""Where ground is looked at, in parts of the half diagonal of an actor's footprint."""
PROBE_M = 2.0
"""From how far away it is looked at."""
GROUND_ALBEDO = 0.2
"""Of a street: worn asphalt has 0.12, concrete 0.3."""
UNSEEN = 0.8
"""The level where no ground is to be seen."""


def beside(actor: Actor, time_s: float) -> FloatArray:
    """Places (P, 3) round an actor's footprint at a time, world frame, at the height of its underside."""
    pose = actor.world_from_actor.at(time_s)
    angle = 2 * np.pi * (np.arange(PROBES) + 0.5) / PROBES
    reach = RING * np.linalg.norm(actor.size_m[:2]) / 2
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(PROBES)], -1) * reach
    return np.asarray(pose[:3, 3] + ring - np.array([0, 0, actor.size_m[2] / 2]))


def level_of(rgb: NDArray[np.float32]) -> FloatArray:
    """Return the light that white horizontal ground would send out (3,), linear, where the ground shows ``rgb`` (N, 3),
    display-referred sRGB. The median, so that a marking or a kerb counts for little."""
    if len(rgb) == 0:
        return np.full(3, UNSEEN)
    return np.asarray(np.median(linear_from_srgb(rgb), axis=0) / GROUND_ALBEDO, np.float64)
