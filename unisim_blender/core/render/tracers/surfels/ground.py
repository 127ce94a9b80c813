"""The height of the ground under a drive as surfels have it: a grid, read at any point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ....data.ground import ground_heights, windows
from ....geometry import FloatArray
from ....ops.constants import GROUND_CELL_M

KNOWN_CELLS = 7
"""Edge, in cells, of the squares around cells with returns in which the ground is known."""


@dataclass(frozen=True)
class HeightGrid:
    """heights (X, Y) of the ground, world frame, at the centres of cells of `GROUND_CELL_M`; the first is at ``low``
    (2,). ``known`` (X, Y) is True where there are returns, there or near."""

    low: FloatArray
    heights: NDArray[np.float32]
    known: NDArray[np.bool_]

    def at(self, points: FloatArray) -> FloatArray:
        """Return heights (N,) of the ground under points (N, 3), world frame: bilinear, and beyond the grid as at its
        edge."""
        shape = np.array(self.heights.shape)
        place = np.clip((points[:, :2] - self.low) / GROUND_CELL_M, 0, shape - 1)
        cell = np.minimum(place.astype(np.int64), np.maximum(shape - 2, 0))
        u, v = (place - cell).T
        x, y = cell.T
        x1, y1 = np.minimum(x + 1, shape[0] - 1), np.minimum(y + 1, shape[1] - 1)
        h = self.heights.astype(np.float64)
        near, far = h[x, y] * (1 - v) + h[x, y1] * v, h[x1, y] * (1 - v) + h[x1, y1] * v
        return np.asarray(near * (1 - u) + far * u)


def height_grid(points: FloatArray) -> HeightGrid:
    """Return the ground under returns (N, 3), world frame, of static things."""
    if len(points) == 0:
        return HeightGrid(np.zeros(2), np.zeros((1, 1), np.float32), np.zeros((1, 1), np.bool_))
    low = np.floor(points[:, :2].min(0) / GROUND_CELL_M)
    cell = np.floor(points[:, :2] / GROUND_CELL_M).astype(np.int64) - low.astype(np.int64)
    across, along = (cell.max(0) + 1).tolist()
    heights, trusted = ground_heights(cell, points[:, 2], (across, along))
    known = windows(trusted.astype(np.float64), KNOWN_CELLS, np.max) > 0
    return HeightGrid((low + 0.5) * GROUND_CELL_M, heights.astype(np.float32), known)
