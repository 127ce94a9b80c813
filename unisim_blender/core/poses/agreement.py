"""How well sweeps agree under a trajectory: the distance from returns of a sweep to the nearest of a later one."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from ..geometry import FloatArray
from .sweeps import first_in_voxels, import_scipy

LAGS = (2, 10, 40)
PAIRS, POINTS = 6, 4000


def lag_pairs(frames: Sequence[int], lag: int) -> list[tuple[int, int]]:
    """Return up to `PAIRS` pairs of frames ``lag`` apart, spread over the drive."""
    there = set(frames)
    pairs = [(frame, frame + lag) for frame in frames if frame + lag in there]
    return [pairs[at] for at in np.unique(np.linspace(0, len(pairs) - 1, PAIRS).astype(int))] if pairs else []


def nearest_m(first: FloatArray, second: FloatArray) -> float:
    """Return the median distance from some of points (N, 3) to the nearest of (M, 3), metres."""
    tree = import_scipy("to measure how well sweeps agree").cKDTree(second)
    some = first[np.linspace(0, len(first) - 1, min(len(first), POINTS)).astype(int)]
    return float(np.median(tree.query(some, workers=-1)[0]))


def agreement(frames: Sequence[int], world: Callable[[int], FloatArray], lags: Sequence[int] = LAGS) -> dict[int, float]:
    """Return by lag the median distance, metres, of standing returns to the nearest of the sweep so many frames later."""
    out = {}
    for lag in lags:
        apart = [nearest_m(world(a), world(b)) for a, b in lag_pairs(frames, lag)]
        if apart:
            out[lag] = float(np.median(apart))
    return out
