"""How well sweeps agree under a drive's poses: the distance from returns of a sweep to the nearest of another one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..geometry import FloatArray, Trajectory, invert_pose, placed
from .refine import corrected, refine
from .sweeps import import_scipy, planes_of

LAGS = (2, 10, 40)
"""Numbers of frames between two sweeps that are compared."""
PAIRS, POINTS = 3, 4000
"""Largest number of pairs of a lag, and of returns of a sweep whose nearest ones are looked for."""
WORSE_M, WORSE = 0.02, 1.25
"""Poses drift where sweeps lie this much, and this many times, further apart than registered ones."""
StandingReturns = Callable[[int], tuple[FloatArray, FloatArray]]
"""Function from a frame to a sweep's standing returns (N, 3), in the sensor's frame at their times (N,)."""


@dataclass(frozen=True)
class LagAgreement:
    """Agreement of sweeps ``lag`` frames apart, medians over some pairs, in metres: ``apart_m``, from a return to the
    nearest one; ``plausible_m``, the same where each pair is registered by itself, by ``moved_m``."""

    lag: int
    apart_m: float
    plausible_m: float
    moved_m: float

    @property
    def is_doubtful(self) -> bool:
        """Whether registered sweeps agree better than chance explains."""
        return self.apart_m > max(self.plausible_m + WORSE_M, self.plausible_m * WORSE)


def lag_pairs(frames: Sequence[int], lag: int) -> list[tuple[int, int]]:
    """Return up to `PAIRS` pairs of frames ``lag`` apart, spread over the drive."""
    there = set(frames)
    pairs = [(frame, frame + lag) for frame in frames if frame + lag in there]
    return [pairs[at] for at in np.unique(np.linspace(0, len(pairs) - 1, PAIRS).astype(int))] if pairs else []


def nearest_m(first: FloatArray, second: FloatArray) -> float:
    """Return the median distance, metres, from some of points (N, 3) to the nearest of (M, 3); NaN without points."""
    if not len(first) or not len(second):
        return float("nan")
    tree = import_scipy("to measure how well sweeps agree,").cKDTree(second)
    some = first[np.linspace(0, len(first) - 1, min(len(first), POINTS)).astype(int)]
    return float(np.median(tree.query(some, workers=-1)[0]))


def agreement(
    frames: Sequence[int], returns: StandingReturns, world_from_lidar: Trajectory
) -> tuple[LagAgreement, ...]:
    """Return how well the sweeps of ``frames`` agree at each of `LAGS` that some of them are apart."""
    sweep = lru_cache(maxsize=2 * PAIRS * len(LAGS))(returns)
    planes = lru_cache(maxsize=2 * PAIRS * len(LAGS))(lambda frame: planes_of(*sweep(frame), world_from_lidar))
    lags = []
    for lag in LAGS:
        rows = []
        for pair in lag_pairs(frames, lag):
            first, second = (placed(world_from_lidar, *sweep(frame)) for frame in pair)
            apart = plausible = nearest_m(first, second)
            moved = 0.0
            if min(len(planes(frame).points) for frame in pair):
                track = corrected(
                    world_from_lidar, refine([planes(frame) for frame in pair], world_from_lidar).correction
                )
                ends = np.array([planes(frame).middle_s for frame in pair])
                steps = [invert_pose(poses[0]) @ poses[1] for poses in (world_from_lidar.at(ends), track.at(ends))]
                registered = nearest_m(*(placed(track, *sweep(frame)) for frame in pair))
                if registered < apart:
                    plausible, moved = registered, float(np.linalg.norm(steps[1][:3, 3] - steps[0][:3, 3]))
            rows.append((apart, plausible, moved))
        if rows:
            lags.append(LagAgreement(lag, *np.median(np.array(rows), 0).tolist()))
    return tuple(lags)
