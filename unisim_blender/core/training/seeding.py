"""The model's state before training: voxels of the volume that can hold something, from LiDAR; the height of the ground
under the drive, on a grid, from LiDAR returns or from where the vehicle drove; and sizes for a long or winding drive.

A grid's cells are as fine in any volume, so detail falls off where more of what is seen shares the rows of its tables:
each metre of a long drive gets as many rows as an ordinary one's. Of a winding drive's box most lies away from the
drive: nothing is looked for there but where LiDAR hit something.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..data.ground import ground_heights
from ..geometry import FloatArray, invert_pose, transform_points
from ..model.config import ModelConfig
from ..model.occupancy import BESIDE, FREE, HIT, UNKNOWN
from ..model.shapes import MAX_VOXELS, cells_of, check_sizes
from ..model.volume import Volume, driven_m, winds
from ..ops.constants import GROUND_CELL_M
from ..world.drive import Drive

KNOWN_M = 8.0
"""Distance from a cell that LiDAR saw up to which the ground is taken to go on."""
DRIVEN_STEP_M = 0.5


def driven_places(drive: Drive) -> FloatArray:
    """Places (N, 3) of the ground that the vehicle drove over, world frame: its own origin is on the ground."""
    trajectory = drive.world_from_ego
    ends = np.array([drive.time_s[frame] for frame in drive.frames])
    length = np.linalg.norm(np.diff(trajectory.positions_at(ends), axis=0), axis=1).sum()
    return np.asarray(trajectory.positions_at(np.linspace(ends[0], ends[-1], 2 + int(length / DRIVEN_STEP_M))))


def seed_ground(points: FloatArray, size_m: FloatArray) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Heights (X, Y) of the ground in cells of 1 m, in volume coordinates, from static points (N, 3) in volume
    coordinates; and in which cells (X, Y) they can be trusted."""
    rows, columns = cells_of(size_m[:2], GROUND_CELL_M)
    cell = np.floor(points[:, :2] / GROUND_CELL_M).astype(np.int64)
    inside = ((cell >= 0) & (cell < (rows, columns))).all(1)
    heights, trusted = ground_heights(cell[inside], points[inside, 2], (rows, columns))
    known = trusted.any() & (ndimage.distance_transform_edt(~trusted) * GROUND_CELL_M <= KNOWN_M)
    return heights.astype(np.float32), known


FREE_UP_TO_M = 120.0
"""Distance from the sensor up to which a ray tells of free space."""
_AT_ONCE = 8192
"""Rays whose numbers stay in a processor's cache."""
_COLUMNS = 32
"""Columns of voxels along the drive whose numbers do."""


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
    sweeps = list(evidence)
    values = np.full(shape, UNKNOWN, np.uint8)
    for value, name in ((FREE, "passed"), (BESIDE, "beside"), (HIT, "hit")):
        for sweep in sweeps:
            values.reshape(-1)[getattr(sweep, name)] = value
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


SEEN_BEYOND_M = 160.0
"""Length of the street before a drive's start and behind its end, in all, that a volume holds."""
USUAL_M = 320.0
"""Metres of street for which the presets' tables are made."""
MOST_ROWS_LOG2 = 22
AWAY_M = 100.0
VOXEL_STEP_M = 0.05


def sized(config: ModelConfig, drive: Drive, volume: Volume) -> ModelConfig:
    """Return the shapes of a drive's model. Raises `SceneError` where the drive is too long for one.

    The static grid has rows in proportion to how far the drive goes, in powers of 2: those of a drive of less than 290 m are as
    they are. Voxels are as large as they must be for no more than `MAX_VOXELS` of them, in a volume of 900 by 900 m or more.
    """
    volume.check(f"{drive.name}: too long for one scene, train parts of it: the volume's size_m")
    length = driven_m(_poses(drive)) + SEEN_BEYOND_M
    doubled = max(0, round(math.log2(length / USUAL_M)))
    grid = config.static_grid
    rows = max(grid.log2_table, min(grid.log2_table + doubled, MOST_ROWS_LOG2))
    shapes = config if rows == grid.log2_table else replace(config, static_grid=replace(grid, log2_table=rows))
    while math.prod(cells_of(volume.size_m, shapes.voxel_m)) > MAX_VOXELS:
        shapes = replace(shapes, voxel_m=round(shapes.voxel_m + VOXEL_STEP_M, 3))
    check_sizes(shapes, volume, drive.name)
    return shapes


def free_away(values: NDArray[np.uint8], volume: Volume, voxel_m: float, drive: Drive) -> None:
    """Free the voxels (X, Y, Z) of a winding drive of which nothing is known and that are more than `AWAY_M` from its way."""
    if not winds(_poses(drive)):
        return
    places = transform_points(invert_pose(volume.world_from_volume), driven_places(drive))
    away = _away(places, values.shape[:2], voxel_m)
    part = values[away]
    part[part == UNKNOWN] = FREE
    values[away] = part


def _poses(drive: Drive) -> FloatArray:
    return drive.world_from_ego.at(np.array([drive.time_s[frame] for frame in drive.frames]))


def _away(places: FloatArray, shape: tuple[int, ...], voxel_m: float) -> NDArray[np.bool_]:
    """Which columns (X, Y) of voxels are away from places (N, 3), volume coordinates."""
    cell = np.clip(np.floor(places[:, :2] / voxel_m).astype(np.int64), 0, np.array(shape) - 1)
    driven = np.zeros(shape, bool)
    driven[cell[:, 0], cell[:, 1]] = True
    return np.asarray(ndimage.distance_transform_edt(~driven) * voxel_m > AWAY_M)
