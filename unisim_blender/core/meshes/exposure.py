"""Brightness of a mesh in a recorded image, estimated from the ground beside it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb
from ..geometry import FloatArray
from ..world.drive import Actor

PROBES = 32
"""Number of places around an actor at which the ground is rendered."""
RING = 1.15
"""Radius of the ring of probed places, relative to half the diagonal of an actor's footprint."""
PROBE_M = 2.0
"""Distance from which the ground is rendered, metres."""
GROUND_ALBEDO = 0.2
"""Albedo of a street: worn asphalt has 0.12, concrete 0.3."""
UNSEEN = 0.8
"""Level of light where no ground is visible."""


def beside(actor: Actor, time_s: float) -> FloatArray:
    """Return places (P, 3), world frame, around an actor's footprint at ``time_s``, at the height of its underside."""
    pose = actor.world_from_actor.at(time_s)
    angle = 2 * np.pi * (np.arange(PROBES) + 0.5) / PROBES
    reach = RING * np.linalg.norm(actor.size_m[:2]) / 2
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(PROBES)], -1) * reach
    return np.asarray(pose[:3, 3] + ring - np.array([0, 0, actor.size_m[2] / 2]))


def level_of(rgb: NDArray[np.float32]) -> FloatArray:
    """Return the linear brightness (3,) of white horizontal ground, from colours ``rgb`` (N, 3) of the real ground,
    display-referred sRGB in 0..1. It is from their median, so that a marking or a kerb counts for little."""
    if len(rgb) == 0:
        return np.full(3, UNSEEN)
    return np.asarray(np.median(linear_from_srgb(rgb), axis=0) / GROUND_ALBEDO, np.float64)
