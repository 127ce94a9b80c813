"""The height of the ground under a drive on a grid, from LiDAR returns, with numpy alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ....geometry import FloatArray
from ....ops.constants import GROUND_CELL_M

OPENING_CELLS = 9
"""Number of cells of the opening: what is high over fewer cells does not belong to the ground."""
MAX_ROUGHNESS_M = 0.4
"""Largest height of ground above the opened grid, in metres."""
SMOOTHING_CELLS = 5
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
    """Return the ground under returns (N, 3), world frame, of static things.

    The lowest of each cell, opened over 9 m so that roofs and walls do not count, filled from beside and
    median-smoothed.
    """
    if len(points) == 0:
        return HeightGrid(np.zeros(2), np.zeros((1, 1), np.float32), np.zeros((1, 1), np.bool_))
    low = np.floor(points[:, :2].min(0) / GROUND_CELL_M)
    cell = np.floor(points[:, :2] / GROUND_CELL_M).astype(np.int64) - low.astype(np.int64)
    shape = tuple((cell.max(0) + 1).tolist())
    flat = cell[:, 0] * shape[1] + cell[:, 1]
    order = np.lexsort((points[:, 2], flat))
    flat, z = flat[order], points[order, 2]
    first = np.flatnonzero(np.r_[True, flat[1:] != flat[:-1]])
    counts = np.diff(np.r_[first, len(flat)])
    lowest = np.full(shape[0] * shape[1], np.nan)
    # the 5th percentile: a few stray returns lie below the road
    lowest[flat[first]] = z[first + (counts * 0.05).astype(np.int64)]
    seen = lowest.reshape(shape)
    filled = fill(seen)
    opened = _windows(_windows(filled, OPENING_CELLS, np.min), OPENING_CELLS, np.max)
    trusted = np.where(filled <= opened + MAX_ROUGHNESS_M, seen, np.nan)
    heights = _windows(fill(trusted), SMOOTHING_CELLS, np.median)
    known = _windows(np.isfinite(trusted).astype(np.float64), KNOWN_CELLS, np.max) > 0
    return HeightGrid((low + 0.5) * GROUND_CELL_M, heights.astype(np.float32), known)


def fill(values: FloatArray) -> FloatArray:
    """Return a map (H, W) or (H, W, C) with NaNs replaced by means of known values around them, from coarser means
    where these are far; 0 where nothing is known."""
    known = np.isfinite(values)
    if known.all():
        return values
    if not known.any():
        return np.zeros_like(values)
    h, w = values.shape[:2]
    if h == w == 1:
        return np.nan_to_num(values)
    pad = ((0, h % 2 if h > 1 else 0), (0, w % 2 if w > 1 else 0), *((0, 0),) * (values.ndim - 2))
    a, n = np.pad(np.where(known, values, 0), pad), np.pad(known.astype(np.float64), pad)
    tall, wide = (2 if h > 1 else 1), (2 if w > 1 else 1)
    blocks = (a.shape[0] // tall, tall, a.shape[1] // wide, wide, *a.shape[2:])
    weight = n.reshape(blocks).sum((1, 3))
    with np.errstate(invalid="ignore", divide="ignore"):
        coarse = fill(a.reshape(blocks).sum((1, 3)) / weight)
    up = np.repeat(np.repeat(coarse, tall, 0), wide, 1)[:h, :w]
    return np.where(known, values, up)


def _windows(values: FloatArray, size: int, reduce: Callable[..., Any]) -> FloatArray:
    """Return a statistic over squares of ``size`` cells around each cell."""
    padded = np.pad(values, size // 2, mode="edge")
    if reduce is np.median:
        return np.asarray(np.median(sliding_window_view(padded, (size, size)), (2, 3)))
    return np.asarray(reduce(sliding_window_view(reduce(sliding_window_view(padded, size, 0), -1), size, 1), -1))
