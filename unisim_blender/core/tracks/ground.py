"""The ground below a drive: a grid of heights from the lowest returns of all sweeps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, Trajectory
from ..poses.sweeps import import_scipy
from .scans import FAR_M

CELL_M = 0.5
OPENING_M = 7.0
"""What stands on the ground and is narrower than this in one direction is no ground: a bus, a row of cars."""
ABOVE_M = 0.25
"""Lowest returns this far above the opened surface are no ground."""
SMOOTH_M = 1.0
DEEP_M = 0.4
"""Returns this far below all around them are reflections."""


@dataclass(frozen=True)
class GroundHeights:
    """Heights (X, Y) of cells `CELL_M` wide, metres; the first cell begins at ``corner`` (2,)."""

    corner: FloatArray
    heights: NDArray[np.float32]

    def height(self, xy: FloatArray) -> FloatArray:
        """Return the ground's heights (N,) below points (N, 2) or (N, 3), linear between cells."""
        from scipy import ndimage

        at = (xy[:, :2] - self.corner).T / CELL_M - 0.5
        return np.asarray(ndimage.map_coordinates(self.heights, at, np.float64, order=1, mode="nearest"))


class GroundBuilder:
    """Takes sweeps one by one; of each cell it stores the two lowest of the sweeps' lowest returns."""

    def __init__(self, ego: Trajectory) -> None:
        self.corner = np.floor(ego.positions[:, :2].min(0) - FAR_M)
        shape = np.ceil((ego.positions[:, :2].max(0) + FAR_M - self.corner) / CELL_M).astype(int)
        self.lowest = np.full((2, *shape.tolist()), np.inf, np.float32)

    def add(self, points: FloatArray) -> None:
        """Add a sweep's returns (N, 3)."""
        shape = self.lowest.shape[1:]
        cell = np.floor((points[:, :2] - self.corner) / CELL_M).astype(np.int64)
        inside = ((cell >= 0) & (cell < shape)).all(1)
        key, z = cell[inside, 0] * shape[1] + cell[inside, 1], points[inside, 2].astype(np.float32)
        order = np.lexsort((z, key))
        cells, first = np.unique(key[order], return_index=True)
        new = z[order][first]
        low, second = self.lowest.reshape(2, -1)
        second[cells] = np.minimum(second[cells], np.maximum(low[cells], new))
        low[cells] = np.minimum(low[cells], new)

    def ground(self) -> GroundHeights:
        """Return the ground below all sweeps so far; level at 0 where nothing returned."""
        import_scipy("to find tracks,")
        from scipy import ndimage

        low, second = self.lowest
        height = np.where(np.isfinite(second), second, low)
        known = np.isfinite(height)
        if not known.any():
            return GroundHeights(self.corner, np.zeros_like(height))

        def filled(values: NDArray[np.float32], there: NDArray[np.bool_]) -> NDArray[np.float32]:
            near = ndimage.distance_transform_edt(~there, return_distances=False, return_indices=True)
            return np.asarray(values[tuple(near)])

        height = filled(height, known)
        median = ndimage.median_filter(height, 5)
        height = np.where(height < median - DEEP_M, median, height)
        opened = ndimage.grey_opening(height, round(OPENING_M / CELL_M))
        is_ground = known & (height - opened < ABOVE_M)
        if not is_ground.any():
            return GroundHeights(self.corner, opened)
        height = filled(height, is_ground)
        return GroundHeights(self.corner, ndimage.gaussian_filter(height, SMOOTH_M / CELL_M).astype(np.float32))
