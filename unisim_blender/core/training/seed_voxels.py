"""Which voxels of the volume can hold something, as LiDAR has it, before training."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..fields.occupancy import BESIDE, FREE, HIT, UNKNOWN
from ..geometry import FloatArray


def seed_voxels(
    origins: FloatArray,
    points: FloatArray,
    shape: tuple[int, int, int],
    voxel_m: float,
    ground: NDArray[np.float32],
    known: NDArray[np.bool_],
) -> NDArray[np.uint8]:
    """Values (X, Y, Z) from LiDAR rays, volume coordinates: origins (N, 3) to static returns (N, 3).

    HIT where a return lies and at the ground between returns (heights and where they are known (X', Y'), cells of 1 m); BESIDE
    in the voxels round a return (UniSim, section 3.2); FREE where rays only passed, and under the ground; UNKNOWN elsewhere.
    """
    hit = np.zeros(shape, bool)
    passed = np.zeros(shape, np.uint8)

    def mark(grid: NDArray, x: FloatArray) -> None:  # type: ignore[type-arg]
        cell = np.floor(x / voxel_m).astype(np.int64)
        cell = cell[((cell >= 0) & (cell < np.array(shape))).all(1)]
        grid[cell[:, 0], cell[:, 1], cell[:, 2]] = 1

    mark(hit, points)
    way = points - origins
    length = np.linalg.norm(way, axis=1)
    step = voxel_m * 0.75
    for i in range(int(min(length.max(initial=0.0), 120.0) / step)):
        t = (i + 0.5) * step
        going = length - 2 * voxel_m > t
        if not going.any():
            break
        mark(passed, origins[going] + way[going] * (t / length[going, None]))
    near = ndimage.binary_dilation(hit, np.ones((3, 3, 3), bool))
    values = np.full(shape, UNKNOWN, np.uint8)
    values[passed > 0] = FREE
    values[near] = BESIDE
    values[hit] = HIT
    top = (np.arange(shape[2]) + 1) * voxel_m
    column = np.minimum(((np.arange(shape[0]) + 0.5) * voxel_m).astype(int), ground.shape[0] - 1)
    row = np.minimum(((np.arange(shape[1]) + 0.5) * voxel_m).astype(int), ground.shape[1] - 1)
    height, trusted = ground[column][:, row][..., None], known[column][:, row][..., None]
    under = top[None, None] < height - 0.5
    at_ground = trusted & (top[None, None] > height - 0.3) & (top[None, None] - voxel_m < height + 0.15)
    values[at_ground] = HIT
    values[under & ~near] = FREE
    return values
