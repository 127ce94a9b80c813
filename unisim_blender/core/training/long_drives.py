"""Extra capacity of the static field of a long or winding drive, so that each metre of it has as much as an ordinary
one's.

A grid's cells are as fine in any volume, so detail falls off where more of what is seen shares the rows of its tables.
And of a winding drive's box most lies away from the drive: nothing is looked for there but where LiDAR found something.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..geometry import FloatArray, invert_pose, transform_points
from ..model.config import ModelConfig
from ..model.occupancy import FREE, UNKNOWN
from ..model.shapes import MOST_VOXELS, cells_of, check_sizes
from ..model.volume import Volume, driven_m, winds
from ..world.drive import Drive
from .seeding import driven_places

SEEN_BEYOND_M = 160.0
"""Of the street before a drive's start and behind its end, in all: a volume's."""
USUAL_M = 320.0
"""Metres of street for which the presets' tables are made."""
MOST_ROWS_LOG2 = 22
AWAY_M = 100.0
VOXEL_STEP_M = 0.05


def sized(config: ModelConfig, drive: Drive, volume: Volume) -> ModelConfig:
    """Return the shapes of a drive's model. Raises `SceneError` where the drive is too long for one.

    The static grid has rows in proportion to how far the drive goes, in powers of 2: those of a drive of less than 290 m are as
    they are. Voxels are as large as they must be for no more than `MOST_VOXELS` of them, in a volume of 900 by 900 m or more.
    """
    volume.check(f"{drive.name}: too long for one scene, train parts of it: the volume's size_m")
    length = driven_m(_poses(drive)) + SEEN_BEYOND_M
    doubled = max(0, round(math.log2(length / USUAL_M)))
    grid = config.static_grid
    rows = max(grid.log2_table, min(grid.log2_table + doubled, MOST_ROWS_LOG2))
    shapes = config if rows == grid.log2_table else replace(config, static_grid=replace(grid, log2_table=rows))
    while math.prod(cells_of(volume.size_m, shapes.voxel_m)) > MOST_VOXELS:
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
