"""The height of the ground under the drive, on a grid, from LiDAR returns, or from where the vehicle drove."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...geometry import FloatArray
from ...model.shapes import cells_of
from ...ops.constants import GROUND_CELL_M
from ...world.drive import Drive

KNOWN_M = 8.0
"""Up to this far from a cell that LiDAR saw, the ground is taken to go on."""


DRIVEN_STEP_M = 0.5


def driven_places(drive: Drive) -> FloatArray:
    """Places (N, 3) of the ground that the vehicle drove over, world frame: its own origin is on the ground."""
    trajectory = drive.world_from_ego
    ends = np.array([drive.time_s[frame] for frame in drive.frames])
    length = np.linalg.norm(np.diff(trajectory.positions_at(ends), axis=0), axis=1).sum()
    return np.asarray(trajectory.positions_at(np.linspace(ends[0], ends[-1], 2 + int(length / DRIVEN_STEP_M))))


def ground_heights(points: FloatArray, size_m: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Heights (X, Y) of the ground in cells of 1 m, in volume coordinates, from static points (N, 3) in volume
    coordinates; and in which cells (X, Y) they can be trusted.

    The lowest returns of a cell, opened over 9 m so that roofs and walls do not count, median-smoothed; cells that no
    LiDAR saw take their nearest neighbour's.
    """
    shape = cells_of(size_m[:2], GROUND_CELL_M)
    cell = np.floor(points[:, :2] / GROUND_CELL_M).astype(np.int64)
    keep = ((cell >= 0) & (cell < np.array(shape))).all(1)
    flat, z = cell[keep, 0] * shape[1] + cell[keep, 1], points[keep, 2]
    lowest = np.full(shape[0] * shape[1], np.inf)
    order = np.lexsort((z, flat))
    flat, z = flat[order], z[order]
    starts = np.flatnonzero(np.r_[True, np.diff(flat) > 0]) if len(flat) else np.zeros(0, np.int64)
    counts = np.diff(np.r_[starts, len(flat)])
    # the 5th percentile: a few stray returns lie below the road
    lowest[flat[starts]] = z[starts + (counts * 0.05).astype(np.int64)] if len(flat) else np.inf
    heights = lowest.reshape(shape)
    if not np.isfinite(heights).any():
        return np.zeros(shape, np.float32), np.zeros(shape, np.bool_)
    heights = _fill(heights)
    opened = ndimage.grey_opening(heights, size=(9, 9))
    trusted = np.isfinite(lowest.reshape(shape)) & (heights <= opened + 0.4)
    known = ndimage.distance_transform_edt(~trusted) * GROUND_CELL_M <= KNOWN_M
    heights = _fill(np.where(trusted, heights, np.inf))
    return ndimage.median_filter(heights, size=5).astype(np.float32), known


def _fill(heights: FloatArray) -> FloatArray:
    nearest = ndimage.distance_transform_edt(~np.isfinite(heights), return_distances=False, return_indices=True)
    return np.asarray(heights[tuple(nearest)])
