"""A crown's clumps as leaves."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import FloatArray

from ..tracing.shapes import Spheres
from ..tracing.triangles import TracedTriangles

_LEAVES_PER_M2 = 50.0
"""Leaves for each square metre of a clump's sphere."""
_LONG_M, _WIDE_M = 0.17, 0.085


def leaves(clumps: Spheres) -> TracedTriangles:
    """Leaves in and on the clumps, each two triangles folded along its rib; the same clumps give the same leaves."""
    rng = np.random.default_rng(np.abs(np.rint(clumps.centers[0] * 1e6)).astype(np.int64))
    count = np.maximum(4, (4 * np.pi * clumps.radii**2 * _LEAVES_PER_M2).astype(int))
    center, radius = np.repeat(clumps.centers, count, 0), np.repeat(clumps.radii, count)[:, None]
    n = len(center)
    out = _unit(rng.standard_normal((n, 3)))
    place = center + out * radius * rng.uniform(0.55, 1.05, (n, 1))
    # a leaf looks up and out of its crown, more or less
    crown = (clumps.low + clumps.high) / 2
    face = _unit(_unit(place - crown) + [0.0, 0.0, 0.6] + 0.8 * rng.standard_normal((n, 3)))
    rib = _unit(np.cross(face, rng.standard_normal((n, 3))))
    side = np.cross(face, rib)
    size = rng.uniform(0.7, 1.25, (n, 1))
    long, wide = _LONG_M / 2 * size * rib, _WIDE_M / 2 * size * side
    lift = 0.012 * size * face
    base, tip, left, right = place - long, place + long, place + wide + lift, place - wide + lift
    return TracedTriangles(
        np.stack([np.stack([base, tip, left], 1), np.stack([base, right, tip], 1)], 1).reshape(-1, 3, 3), speckled=True
    )


def _unit(v: FloatArray) -> FloatArray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
