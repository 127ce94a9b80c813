"""The model's state before training: voxels of the volume that can hold something, from LiDAR, and the height of the
ground under the drive, on a grid, from LiDAR returns, or from where the vehicle drove."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..geometry import FloatArray
from ..model.occupancy import BESIDE, FREE, HIT, UNKNOWN
from ..model.shapes import cells_of
from ..ops.constants import GROUND_CELL_M
from ..world.drive import Drive

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


FREE_UP_TO_M = 120.0
"""Up to this far from the sensor a ray tells of free space."""

_AT_ONCE = 8192
"""Rays whose numbers stay in a processor's cache."""
_COLUMNS = 32
"""Of voxels, along the drive, whose numbers do."""


def seed_voxels(
    origins: FloatArray,
    points: FloatArray,
    shape: tuple[int, int, int],
    voxel_m: float,
    ground: NDArray[np.float32],
    known: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Values (X, Y, Z) from LiDAR rays, volume coordinates: origins (N, 3) to static returns (N, 3).

    HIT where a return lies and at the ground between returns (heights and where they are known (X', Y'), cells of 1 m);
    BESIDE in the voxels round a return (UniSim, section 3.2); FREE where rays only passed, and under the ground;
    UNKNOWN elsewhere.
    """
    hit, passed = _followed(origins, points, shape, voxel_m)
    values = np.full(shape, UNKNOWN, np.uint8)
    for value, cells in ((FREE, passed), (BESIDE, _grown(hit)), (HIT, hit)):
        values[cells] = value
    _add_ground(values, voxel_m, ground, known)
    return values


def seed_by_evidence(
    evidence: Iterable[VoxelEvidence],
    shape: tuple[int, int, int],
    voxel_m: float,
    ground: NDArray[np.float32],
    known: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Values (X, Y, Z) as `seed_voxels` gives them, from what some sweeps' rays tell of."""
    found = list(evidence)
    values = np.full(shape, UNKNOWN, np.uint8)
    for value, name in ((FREE, "passed"), (BESIDE, "beside"), (HIT, "hit")):
        for one in found:
            values.reshape(-1)[getattr(one, name)] = value
    _add_ground(values, voxel_m, ground, known)
    return values


def _add_ground(
    values: NDArray[np.uint8], voxel_m: float, ground: NDArray[np.float32], known: NDArray[np.bool_]
) -> None:
    """Have HIT in voxels (X, Y, Z) at the ground, and FREE under it where there is no return and none beside."""
    shape = values.shape
    top = (np.arange(shape[2]) + 1) * voxel_m
    column = np.minimum(((np.arange(shape[0]) + 0.5) * voxel_m).astype(int), ground.shape[0] - 1)
    row = np.minimum(((np.arange(shape[1]) + 0.5) * voxel_m).astype(int), ground.shape[1] - 1)
    # a part at a time: what is worked out for it stays in a processor's cache
    for begin in range(0, shape[0], _COLUMNS):
        part, here = values[begin : begin + _COLUMNS], column[begin : begin + _COLUMNS]
        height, trusted = ground[here][:, row][..., None], known[here][:, row][..., None]
        under = (top < height - 0.5) & (part < BESIDE)
        part[trusted & (top > height - 0.3) & (top - voxel_m < height + 0.15)] = HIT
        part[under] = FREE


@dataclass(frozen=True)
class VoxelEvidence:
    """Voxels that LiDAR rays give evidence of: flat numbers (N,) of voxels in which a return lies, of those round one,
    and of those that rays only passed; a voxel may be in more than one."""

    hit: NDArray[np.int64]
    beside: NDArray[np.int64]
    passed: NDArray[np.int64]


def voxel_evidence(
    origins: FloatArray, points: FloatArray, shape: tuple[int, int, int], voxel_m: float
) -> VoxelEvidence:
    """Return the evidence of some rays, as in `seed_voxels`, at a cost that grows with the rays' reach and not with the
    volume."""
    if not len(points):
        return VoxelEvidence(*(np.zeros(0, np.int64) for _ in range(3)))
    ends = np.concatenate([origins, points])
    lower = np.clip(np.floor(ends.min(0) / voxel_m).astype(np.int64) - 1, 0, np.array(shape) - 1)
    upper = np.clip(np.floor(ends.max(0) / voxel_m).astype(np.int64) + 2, lower + 1, shape)
    x, y, z = (upper - lower).tolist()
    hit, passed = _followed(origins - lower * voxel_m, points - lower * voxel_m, (x, y, z), voxel_m)
    return VoxelEvidence(*(_numbers(part, lower, shape) for part in (hit, _grown(hit), passed)))


def _grown(grid: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """The cells that are set, and those that touch one: dilated by a cube of three, axis by axis."""
    out = grid.copy()
    for axis in range(3):
        grown, of = np.moveaxis(out, axis, 0), np.moveaxis(out.copy(), axis, 0)
        grown[1:] |= of[:-1]
        grown[:-1] |= of[1:]
    return out


def _numbers(part: NDArray[np.bool_], lower: NDArray[np.int64], shape: tuple[int, int, int]) -> NDArray[np.int64]:
    """Flat numbers, in a grid of a shape, of the cells that are set in a part of it."""
    x, y, z = (at + low for at, low in zip(np.nonzero(part), lower, strict=True))
    return np.asarray((x * shape[1] + y) * shape[2] + z)


def _followed(
    origins: FloatArray, points: FloatArray, shape: tuple[int, int, int], voxel_m: float
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which voxels (X, Y, Z) rays end in, and which they pass."""
    hit, passed = np.zeros(shape, bool), np.zeros(shape, bool)
    _mark(hit, points.T / voxel_m)
    beams = points - origins
    length = np.linalg.norm(beams, axis=1)
    step = voxel_m * 0.75
    order = np.argsort(-length)
    for begin in range(0, len(order), _AT_ONCE):
        rays = order[begin : begin + _AT_ONCE]
        far, start, to = length[rays] - 2 * voxel_m, origins[rays].T / voxel_m, beams[rays].T / (voxel_m * length[rays])
        middles = (np.arange(int(min(length[rays[0]], FREE_UP_TO_M) / step)) + 0.5) * step
        going = np.searchsorted(-far, -middles)
        for t, count in zip(middles, going, strict=True):
            _mark(passed, start[:, :count] + to[:, :count] * t)
    return hit, passed


def _mark(grid: NDArray[np.bool_], places: FloatArray) -> None:
    """Sets the cells of a grid (X, Y, Z) that hold places (3, N), in cells; those outside count for nothing."""
    x, y, z = np.floor(places).astype(np.int32)
    x_end, y_end, z_end = grid.shape
    within = (x >= 0) & (x < x_end) & (y >= 0) & (y < y_end) & (z >= 0) & (z < z_end)
    grid.reshape(-1)[((x * y_end + y) * z_end + z)[within]] = True
