"""What stays: whether a place that a return lies at is seen through at other times.

Each sweep is an image of ranges over direction. A place is free at the time of another sweep whose rays pass it by and
go on, occupied where one of them ends at it, and unobserved behind what returned (visibility, as in Kim and Kim,
"Remove, then revert", IROS 2020; free space over time, as in Schmid et al., "Dynablox", RA-L 2023).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from .scans import Scan, ScanRef

STEP_RAD = np.radians(0.4)
LOWEST_RAD, HIGHEST_RAD = np.radians(-36.0), np.radians(16.0)
COLUMNS, ROWS = int(2 * np.pi / STEP_RAD), int((HIGHEST_RAD - LOWEST_RAD) / STEP_RAD)
ORIGINS = 72
"""Number of directions whose rays' origin is stored: a rolling sweep's ego moves."""
MARGIN_M, MARGIN = 0.4, 0.008
"""A ray ends at a place within this, and this part of its range; it passes by where it ends later."""
WINDOWS_S = ((0.25, 1.2), (1.2, 4.0), (4.0, 12.0), (12.0, 60.0))
"""Times between a return and the sweeps that may see through its place, before and after it."""
LOOKS = 5
"""Largest number of sweeps of a window."""
LEAST_FREE, FREE = 2, 0.6
"""A place is left or entered where this many sweeps of a window, and this part of those that observe it, see through."""


@dataclass(frozen=True)
class RangeImage:
    """Nearest and furthest ranges (`ROWS`, `COLUMNS`) of a sweep by elevation and azimuth in the world, metres, infinite
    and 0 where no ray returned; origins (`ORIGINS`, 3) of rays by azimuth."""

    nearest: NDArray[np.float16]
    furthest: NDArray[np.float16]
    passed: NDArray[np.float16]
    """The nearest range of three columns: rays that pass beside a thin thing do not see through it."""
    origins: FloatArray

    def looks(self, points: FloatArray) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
        """Return whether the places (N, 3) are free, and whether they are occupied (N,)."""
        origin = self.origins.mean(0)
        for _ in range(2):  # the origin of the ray towards a place depends on its azimuth
            away = points - origin
            azimuth = np.arctan2(away[:, 1], away[:, 0])
            origin = self.origins[(azimuth / (2 * np.pi) * ORIGINS).astype(np.int64) % ORIGINS]
        row, column, range_m = _cells(points - origin)
        seen = (row >= 0) & (row < ROWS)
        row = np.clip(row, 0, ROWS - 1)
        margin = MARGIN_M + MARGIN * range_m
        nearest, furthest = (values[row, column].astype(np.float64) for values in (self.nearest, self.furthest))
        passed = self.passed[row, column].astype(np.float64)
        free = seen & (passed > range_m + margin) & (furthest > 0)
        occupied = seen & ((abs(nearest - range_m) < margin) | (abs(furthest - range_m) < margin))
        return free, occupied


def _cells(away: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    flat = np.hypot(away[:, 0], away[:, 1])
    row = np.floor((np.arctan2(away[:, 2], flat) - LOWEST_RAD) / STEP_RAD).astype(np.int64)
    column = np.floor(np.arctan2(away[:, 1], away[:, 0]) / STEP_RAD).astype(np.int64) % COLUMNS
    return row, column, np.hypot(flat, away[:, 2])


def range_image(scan: Scan) -> RangeImage:
    """Return the ranges of a sweep's returns by direction."""
    row, column, range_m = _cells(scan.points - scan.origins)
    inside = np.flatnonzero((row >= 0) & (row < ROWS))
    nearest = np.full(ROWS * COLUMNS, np.inf, np.float16)
    furthest = np.zeros(ROWS * COLUMNS, np.float16)
    cell = (row * COLUMNS + column)[inside]
    order = np.lexsort((range_m[inside], cell))
    cell, ranges = cell[order], range_m[inside][order]
    cells, first = np.unique(cell, return_index=True)
    last = np.append(first, len(cell))[1:] - 1
    nearest[cells], furthest[cells] = ranges[first], ranges[last]
    image = nearest.reshape(ROWS, COLUMNS)
    passed = np.minimum(image, np.minimum(np.roll(image, 1, 1), np.roll(image, -1, 1)))
    return RangeImage(image, furthest.reshape(ROWS, COLUMNS), passed, _origins(scan))


def _origins(scan: Scan) -> FloatArray:
    """Return the mean origin of rays in each direction; where there are none, of all."""
    if not len(scan.points):
        return np.zeros((ORIGINS, 3))
    away = scan.points - scan.origins
    bins = (np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi) * ORIGINS).astype(np.int64) % ORIGINS
    counts = np.bincount(bins, minlength=ORIGINS)
    sums = np.stack([np.bincount(bins, scan.origins[:, axis], ORIGINS) for axis in range(3)], 1)
    return np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], scan.origins.mean(0))


def windows(refs: Sequence[ScanRef], at: int) -> list[list[int]]:
    """Return the sweeps of each window before and after sweep ``at``, those without `LEAST_FREE` sweeps left out."""
    times = np.array([ref.time_s for ref in refs]) - refs[at].time_s
    chosen = []
    for side in (-1, 1):
        for start, end in WINDOWS_S:
            there = np.flatnonzero((side * times >= start) & (side * times < end))
            if len(there) >= LEAST_FREE:
                chosen.append(there[np.unique(np.linspace(0, len(there) - 1, LOOKS).astype(int))].tolist())
    return chosen


def left_or_entered(
    points: FloatArray, images: Mapping[int, RangeImage], chosen: Sequence[Sequence[int]]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return whether places (N, 3) are free during one of the windows, and whether they are occupied at every time that
    observes them (N,); neither where too little observes them."""
    moving = np.zeros(len(points), np.bool_)
    free_all, occupied_all = np.zeros(len(points), np.int64), np.zeros(len(points), np.int64)
    for window in chosen:
        free, occupied = np.sum([images[at].looks(points) for at in window], axis=0)
        moving |= (free >= LEAST_FREE) & (free >= FREE * (free + occupied))
        free_all += free
        occupied_all += occupied
    return moving, ~moving & (occupied_all >= LEAST_FREE) & (occupied_all > 2 * free_all)
