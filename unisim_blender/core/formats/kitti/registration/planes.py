"""Points of a sweep that lie on a plane, with its normal, told from their neighbours in beams x columns.

Nearest neighbours in space will not do: far from the sensor they lie along one ring, and tell no plane. What they tell instead
moves along with the sensor, and holds a registration back.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....geometry import FloatArray

COLUMN_STEPS = (-4, -2, 0, 2, 4)
RING_STEPS = (-1, 0, 1)
FEWEST = 8
"""Neighbours that tell a plane."""
FLAT_M = 0.03
"""How far neighbours lie from their plane, at most, root mean square."""
WIDE_M = 0.03
WIDER = 4.5
"""A patch is at least this wide, and this many times wider than it is thick: else it is a line."""
NEAR_M, FAR_M = 3.0, 60.0


@dataclass(frozen=True)
class SweepPlanes:
    """Points of a sweep and their planes' unit normals (N, 3), in the sensor's frame at each point's own time, ``late_s`` (N,)
    after ``time_s``."""

    points: FloatArray
    normals: FloatArray
    late_s: FloatArray
    time_s: float


def find_planes(
    points: FloatArray, ring: NDArray[np.int32], column: NDArray[np.int32], beams: int, columns: int, every: int = 1
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return which points (M,) of a sweep (N, 3) lie on planes, and these's normals (M, 3), which look at the sensor.

    ``ring`` and ``column`` (N,) as in a `Sweep`; those with -1 are left out. Only points of every ``every``-th column
    are looked at.
    """
    known = np.flatnonzero(ring >= 0)
    grid = np.full((beams, columns, 3), np.nan, np.float32)
    index = np.zeros((beams, columns), np.int64)
    grid[ring[known], column[known]] = points[known, :3]
    index[ring[known], column[known]] = known
    distance = np.linalg.norm(grid, axis=-1)
    used = np.flatnonzero(((distance > NEAR_M) & (distance < FAR_M)).ravel())
    used = used[used % columns % every == 0]
    beam, at = np.divmod(used, columns)
    centre, reach = grid[beam, at], 0.05 * distance[beam, at] + 0.3
    count = np.zeros(len(used), np.float32)
    total, products = np.zeros((len(used), 3), np.float32), np.zeros((len(used), 3, 3), np.float32)
    for up in RING_STEPS:
        inside = (beam + up >= 0) & (beam + up < beams)
        for along in COLUMN_STEPS:
            offset = grid[np.clip(beam + up, 0, beams - 1), (at + along) % columns] - centre
            near = inside & (np.linalg.norm(offset, axis=1) < reach)  # nan is no neighbour
            offset[~near] = 0
            count += near
            total += offset
            products += offset[:, :, None] * offset[:, None, :]
    told = np.flatnonzero(count >= FEWEST)
    mean = total[told] / count[told, None]
    spread = products[told] / count[told, None, None] - mean[:, :, None] * mean[:, None, :]
    width, axes = np.linalg.eigh(spread.astype(np.float64))
    thick, wide = np.sqrt(np.maximum(width[:, 0], 0)), np.sqrt(np.maximum(width[:, 1], 0))
    flat = (thick < FLAT_M) & (wide > WIDE_M) & (wide > WIDER * thick)
    chosen = index[beam[told[flat]], at[told[flat]]]
    normals = axes[flat, :, 0]
    facing = np.sum(normals * points[chosen, :3], 1) > 0
    return chosen, np.where(facing[:, None], -normals, normals)


def one_a_voxel(points: FloatArray, voxel_m: float) -> NDArray[np.int64]:
    """Return indices of points (N, 3), one in each voxel that holds any, in order."""
    cell = np.floor(points / voxel_m).astype(np.int64)
    cell -= cell.min(0, initial=0)
    span = cell.max(0, initial=0) + 1
    _, first = np.unique((cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2], return_index=True)
    return np.sort(first)
