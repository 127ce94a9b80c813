"""The height of the ground on a grid of cells, from LiDAR returns, with numpy alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray

OPENING_CELLS = 9
"""Number of cells of the opening: what is high over fewer cells does not belong to the ground."""
MAX_ROUGHNESS_M = 0.4
"""Largest height of ground above the opened grid, in metres."""
STANDING_M, MAX_FOOT_M = 0.7, 0.2
"""Height, in metres, of the returns of a cell in which something stands, whose lowest may be a part of it; and how high above
the ground beside it they are ground."""
SMOOTHING_CELLS = 5


def ground_heights(cell: NDArray[np.int64], z: FloatArray, shape: tuple[int, int]) -> tuple[FloatArray, BoolArray]:
    """Return heights (X, Y) of the ground, and in which cells returns lie on it (X, Y), from static returns: their cells (N, 2)
    and heights (N,).

    The lowest of each cell, opened so that roofs do not count, nor a wall whose foot is hidden, filled from beside and
    median-smoothed.
    """
    flat = cell[:, 0] * shape[1] + cell[:, 1]
    order = np.lexsort((z, flat))
    flat, z = flat[order], z[order]
    first = np.flatnonzero(np.r_[True, flat[1:] != flat[:-1]][: len(flat)])
    counts = np.diff(np.r_[first, len(flat)])
    lowest, spread = np.full((2, shape[0] * shape[1]), np.nan)
    # the 5th percentile: a few stray returns lie below the road
    lowest[flat[first]] = z[first + (counts * 0.05).astype(np.int64)]
    spread[flat[first]] = z[first + (counts * 0.95).astype(np.int64)] - lowest[flat[first]]
    lowest, stands = lowest.reshape(shape), spread.reshape(shape) > STANDING_M
    # behind a wall nothing is seen: by its own cells it would be the edge of higher ground
    beside = lowest if stands[np.isfinite(lowest)].all() else np.where(stands, np.nan, lowest)
    opened = np.minimum(_opened(lowest), _opened(beside))
    with np.errstate(invalid="ignore"):
        trusted = lowest <= opened + np.where(stands, MAX_FOOT_M, MAX_ROUGHNESS_M)
    return windows(fill(np.where(trusted, lowest, np.nan)), SMOOTHING_CELLS, np.median), trusted


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


def _opened(heights: FloatArray) -> FloatArray:
    return windows(windows(fill(heights), OPENING_CELLS, np.min), OPENING_CELLS, np.max)


def windows(values: FloatArray, size: int, reduce: Callable[..., Any]) -> FloatArray:
    """Return a statistic over squares of ``size`` cells around each cell."""
    padded = np.pad(values, size // 2, mode="edge")
    if reduce is np.median:
        return np.asarray(np.median(sliding_window_view(padded, (size, size)), (2, 3)))
    return np.asarray(reduce(sliding_window_view(reduce(sliding_window_view(padded, size, 0), -1), size, 1), -1))
