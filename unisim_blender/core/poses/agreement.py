"""How well sweeps agree under a drive's poses: the distances from returns of a sweep to the nearest one, and to the planes, of
another sweep.

Returns lie a hand's breadth from the nearest one of any sweep, however well it fits; an error of pitch of a milliradian
shows in distances to planes alone."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..data.log import PlaneSweep
from ..geometry import FloatArray, Trajectory, invert_pose, placed
from .refine import corrected, refine
from .sweeps import import_scipy, planes_of

LAGS = (2, 10, 40)
"""Numbers of frames between two sweeps that are compared."""
PAIRS, POINTS = 3, 4000
"""Largest number of pairs of a lag, and of returns of a sweep whose nearest ones are looked for."""
WORSE_M, WORSE = 0.003, 1.2
"""Poses drift where sweeps lie this much, and this many times, further from each other's planes than registered ones."""
PLANE_REACH_M = 0.5
"""Distance from a return within which a plane of another sweep is looked for."""
StandingReturns = Callable[[int], tuple[FloatArray, FloatArray]]
"""Function from a frame to a sweep's standing returns (N, 3), in the sensor's frame at their times (N,)."""


@dataclass(frozen=True)
class LagAgreement:
    """Agreement of sweeps ``lag`` frames apart, medians over some pairs, in metres: ``apart_m``, from a return to the
    nearest one; ``off_planes_m``, to the plane there; ``plausible_m`` and ``plausible_off_planes_m``, the same where each pair
    is registered by itself, by ``moved_m``."""

    lag: int
    apart_m: float
    plausible_m: float
    off_planes_m: float
    plausible_off_planes_m: float
    moved_m: float

    @property
    def is_doubtful(self) -> bool:
        """Whether registered sweeps agree better than chance explains."""
        plausible_m = self.plausible_off_planes_m
        return self.off_planes_m > max(plausible_m + WORSE_M, plausible_m * WORSE)


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


def off_planes_m(first: PlaneSweep, second: PlaneSweep, track: Trajectory) -> float:
    """Return the median distance, metres, from a sweep's points to the nearest planes of another; 0 without points, and
    `PLANE_REACH_M` where none has a plane near."""
    if not len(first.points) or not len(second.points):
        return 0.0
    here, there = (placed(track, sweep.points, sweep.time_s) for sweep in (first, second))
    tree = import_scipy("to measure how well sweeps agree,").cKDTree(there)
    distance, near = tree.query(here, distance_upper_bound=PLANE_REACH_M, workers=-1)
    met = np.isfinite(distance)
    near = near[met]
    normals = np.einsum("nij,nj->ni", track.at(second.time_s[near])[:, :3, :3], second.normals[near])
    return float(np.median(np.abs(np.sum(normals * (here[met] - there[near]), 1)))) if met.any() else PLANE_REACH_M


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
            apart = plausible = nearest_m(*(placed(world_from_lidar, *sweep(frame)) for frame in pair))
            first, second = (planes(frame) for frame in pair)
            off_planes = plausible_off_planes = off_planes_m(first, second, world_from_lidar)
            moved = 0.0
            if off_planes > 0:
                track = corrected(world_from_lidar, refine([first, second], world_from_lidar).correction)
                registered = off_planes_m(first, second, track)
                if registered < off_planes:
                    ends = np.array([first.middle_s, second.middle_s])
                    steps = [invert_pose(poses[0]) @ poses[1] for poses in (world_from_lidar.at(ends), track.at(ends))]
                    plausible_off_planes, moved = registered, float(np.linalg.norm(steps[1][:3, 3] - steps[0][:3, 3]))
                    plausible = min(apart, nearest_m(*(placed(track, *sweep(frame)) for frame in pair)))
            rows.append((apart, plausible, off_planes, plausible_off_planes, moved))
        if rows:
            lags.append(LagAgreement(lag, *np.median(np.array(rows), 0).tolist()))
    return tuple(lags)
