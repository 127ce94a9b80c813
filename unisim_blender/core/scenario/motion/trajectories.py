"""Operations on trajectories: displace, compose, hold at the ends, retime.

Keys are joined by lines and slerp. Where an edit makes something else between keys (a lever arm on a turning vehicle),
keys are added until the difference is below `POSITION_TOLERANCE_M` and `ROTATION_TOLERANCE_RAD`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...geometry import (
    BoolArray,
    FloatArray,
    Trajectory,
    TrajectoryError,
    make_pose,
    quaternion_from_matrix,
    quaternion_from_yaw,
    quaternion_product,
    slerp,
)

POSITION_TOLERANCE_M = 1e-6
ROTATION_TOLERANCE_RAD = 1e-7
MAX_HALVINGS = 12
MAX_KEYS = 100_000
"""Largest number of keys of a path drawn with lines. A path that needs more turns too fast, too far from the centre
that it turns about."""
SAME_TIME_S = 1e-9
"""Times closer than this are one key."""

Poses = Callable[[FloatArray], FloatArray]
Indices = NDArray[np.int64]


def merged_times(own: FloatArray, *others: FloatArray) -> FloatArray:
    """``own`` times and, in order, the others that lie further than `SAME_TIME_S` from all of them and
    from each other."""
    merged = np.unique(np.concatenate(others))
    merged = merged[np.concatenate([[True], np.diff(merged) > SAME_TIME_S])]
    after = np.searchsorted(own, merged)
    far_left = merged - own[np.maximum(after - 1, 0)]
    far_right = own[np.minimum(after, len(own) - 1)] - merged
    new = (np.abs(far_left) > SAME_TIME_S) & (np.abs(far_right) > SAME_TIME_S)
    return np.sort(np.concatenate([own, merged[new]]))


def _halved(
    times: Sequence[FloatArray],
    values_at: Callable[[FloatArray, Indices], FloatArray],
    mismatch: Callable[[FloatArray, FloatArray, FloatArray], BoolArray],
) -> list[tuple[FloatArray, FloatArray]]:
    """Return for each of several curves its times with midpoints added until ``mismatch`` is nowhere true, of the
    values at intervals' starts, middles and ends; and the values at these times. ``values_at`` gets times and the
    curves' numbers."""
    counts = [len(curve_times) for curve_times in times]
    which, every = np.repeat(np.arange(len(counts)), counts), np.concatenate(times)
    begins = np.flatnonzero(which[1:] == which[:-1])
    starts, ends, own = every[begins], every[begins + 1], which[begins]
    middles = (starts + ends) / 2
    sampled = values_at(np.concatenate([every, middles]), np.concatenate([which, own]))
    values, between = np.split(sampled, [len(every)])
    first, last = values[begins], values[begins + 1]
    for count in range(MAX_HALVINGS):
        if count:
            middles = (starts + ends) / 2
            between = values_at(middles, own)
        bad = mismatch(first, between, last)
        if not bad.any():
            break
        every, which = np.concatenate([every, middles[bad]]), np.concatenate([which, own[bad]])
        if np.bincount(which).max() > MAX_KEYS:
            raise TrajectoryError(
                f"a path takes more than {MAX_KEYS} keys to follow: it turns too fast for where it is"
            )
        values = np.concatenate([values, between[bad]])
        # the others match already
        starts, ends = np.append(starts[bad], middles[bad]), np.append(middles[bad], ends[bad])
        first, last = np.concatenate([first[bad], between[bad]]), np.concatenate([between[bad], last[bad]])
        own = np.tile(own[bad], 2)
    order = np.lexsort((every, which))
    parts = np.split(order, np.cumsum(np.bincount(which, minlength=len(counts)))[:-1])
    return [(every[part], values[part]) for part in parts]


def offset_curve(
    trajectory: Trajectory, times: FloatArray, offset_at: Callable[[FloatArray], FloatArray]
) -> Trajectory:
    """World displacements of an object by ``offset_at`` (times -> (T, 3)) along the trajectory's own axes,
    as a moving point.

    The rotation of what is returned means nothing.
    """

    def displacement(t: FloatArray, _: Indices) -> FloatArray:
        return np.asarray((trajectory.at(t)[:, :3, :3] @ offset_at(t)[:, :, None])[:, :, 0])

    def mismatch(starts: FloatArray, middles: FloatArray, ends: FloatArray) -> BoolArray:
        return np.asarray(np.abs((starts + ends) / 2 - middles).max(-1) > POSITION_TOLERANCE_M)

    ((times, displacements),) = _halved([times], displacement, mismatch)
    return Trajectory(times, displacements, np.tile([1.0, 0, 0, 0], (len(times), 1)))


def displaced(trajectory: Trajectory, curve: Trajectory) -> Trajectory:
    """Return the trajectory plus the displacement that ``curve`` has at each time. Exact: both are lines between the
    union of keys.

    Rotations stay as they are, to the bit at the trajectory's own keys.
    """
    times = merged_times(trajectory.times_s, curve.times_s)
    positions, quaternions = sampled_keys(trajectory, times)
    return Trajectory(times, positions + curve.at(times)[:, :3, 3], quaternions)


def sampled_keys(trajectory: Trajectory, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Positions (T, 3) and quaternions (T, 4) at times; at the trajectory's own keys those, to the bit."""
    poses = trajectory.at(times)
    positions, quaternions = poses[:, :3, 3].copy(), quaternion_from_matrix(poses[:, :3, :3])
    index = np.minimum(np.searchsorted(trajectory.times_s, times), len(trajectory.times_s) - 1)
    own = trajectory.times_s[index] == times
    positions[own], quaternions[own] = trajectory.positions[index[own]], trajectory.quaternions_wxyz[index[own]]
    return positions, quaternions


def sampled(poses_at: Poses, times: FloatArray) -> Trajectory:
    """Return a trajectory with keys at ``times``, and between them wherever lines and slerp would miss ``poses_at``."""
    return sampled_together(lambda t, _: poses_at(t), [times])[0]


def sampled_together(
    poses_at: Callable[[FloatArray, Indices], FloatArray], times: Sequence[FloatArray]
) -> list[Trajectory]:
    """Return `sampled` of several trajectories at once, which is faster: ``poses_at`` gets times (N,) and the
    trajectories' numbers (N,)."""

    def values_at(times: FloatArray, which: Indices) -> FloatArray:
        poses = poses_at(times, which)
        return np.concatenate([poses[:, :3, 3], quaternion_from_matrix(poses[:, :3, :3])], 1)

    def mismatch(starts: FloatArray, middles: FloatArray, ends: FloatArray) -> BoolArray:
        position_error = np.abs((starts[:, :3] + ends[:, :3]) / 2 - middles[:, :3]).max(-1)
        true = middles[:, 3:]
        middle = slerp(starts[:, 3:], ends[:, 3:], np.full(len(starts), 0.5))
        half_angle = np.minimum(np.linalg.norm(middle - true, axis=-1), np.linalg.norm(middle + true, axis=-1))
        return np.asarray((position_error > POSITION_TOLERANCE_M) | (2 * half_angle > ROTATION_TOLERANCE_RAD))

    curves = _halved(times, values_at, mismatch)
    return [Trajectory(times, values[:, :3], values[:, 3:]) for times, values in curves]


class Stacked:
    """Trajectories whose poses are asked for together."""

    def __init__(self, trajectories: Sequence[Trajectory]) -> None:
        self._times = [trajectory.times_s for trajectory in trajectories]
        counts = [len(trajectory) for trajectory in self._times]
        self._first = np.cumsum(counts) - counts
        self._keys = tuple(
            np.concatenate([getattr(trajectory, name) for trajectory in trajectories])
            for name in ("times_s", "positions", "quaternions_wxyz")
        )

    def at(self, time_s: FloatArray, which: Indices) -> FloatArray:
        """Return poses (N, 4, 4) at times (N,) of trajectories of these numbers (N,): those of `Trajectory.at`, to the
        bit."""
        lower, last = np.zeros(len(which), np.int64), np.array([len(keys) - 1 for keys in self._times])
        for number, times in enumerate(self._times):
            own = which == number
            lower[own] = np.searchsorted(times, time_s[own], side="right") - 1
        lower = self._first[which] + np.clip(lower, 0, np.maximum(last[which] - 1, 0))
        upper = lower + (last[which] > 0)
        times, positions, quaternions = self._keys
        length = times[upper] - times[lower]
        u = (time_s - times[lower]) / np.where(length > 0, length, 1.0)
        places = positions[lower] + u[:, None] * (positions[upper] - positions[lower])
        return make_pose(places, slerp(quaternions[lower], quaternions[upper], u))


def holding_ends(trajectory: Trajectory) -> Trajectory:
    """Return the trajectory, standing still before its first key and after its last."""
    if len(trajectory.times_s) == 1:
        return trajectory
    index = np.concatenate([[0], np.arange(len(trajectory.times_s)), [-1]])
    times = trajectory.times_s[index]
    times[0], times[-1] = times[0] - 1, times[-1] + 1
    return Trajectory(times, trajectory.positions[index], trajectory.quaternions_wxyz[index])


@dataclass(frozen=True)
class Resting:
    """Rest of a trajectory with keys at ``times_s`` (T,), to the bit. ``since_s`` (T,): when each key's pose was
    reached."""

    times_s: FloatArray
    since_s: FloatArray

    @staticmethod
    def on(trajectory: Trajectory) -> Resting:
        poses = np.concatenate([trajectory.positions, trajectory.quaternions_wxyz], 1)
        reached = np.concatenate([[True], (poses[1:] != poses[:-1]).any(1)])
        first = np.maximum.accumulate(np.where(reached, np.arange(len(poses)), 0))
        return Resting(trajectory.times_s, trajectory.times_s[first])

    @cached_property
    def _stands(self) -> bool:
        return bool((self.since_s != self.times_s).any())

    def since(self, time_s: FloatArray) -> FloatArray:
        """Return times (N,), of which those at which the trajectory stands are when it came to stand there."""
        last = len(self.times_s) - 1
        if not self._stands and last > 0:
            return time_s
        if last == 0:
            return np.full(len(time_s), self.times_s[0])
        at = np.searchsorted(self.times_s, time_s, side="right") - 1
        key = np.maximum(at, 0)
        stands = self.since_s[key] == self.since_s[np.minimum(key + 1, last)]
        # behind its last key it goes on as it came there
        stands &= (at < last) | (self.since_s[last] != self.times_s[last])
        return np.where((at >= 0) & (stands | (self.times_s[key] == time_s)), self.since_s[key], time_s)


def is_moving(trajectory: Trajectory) -> bool:
    """Return whether the pose changes between keys."""
    turned = 1 - np.abs(trajectory.quaternions_wxyz @ trajectory.quaternions_wxyz[0])
    return bool((np.abs(trajectory.positions - trajectory.positions[0]) > 1e-4).any() or (turned > 1e-9).any())


@dataclass(frozen=True)
class TimeMap:
    """Scenario times to recorded times: lines through the knots, with ``slope`` before the first and after the last.

    scenario_s (N,) increases, recorded_s (N,) never falls; where it stays, time stands still.
    """

    scenario_s: FloatArray
    recorded_s: FloatArray
    slope: float = 1.0

    def recorded(self, scenario_s: FloatArray) -> FloatArray:
        """Recorded times (T,) of scenario times (T,)."""
        inside = np.interp(scenario_s, self.scenario_s, self.recorded_s)
        before = np.minimum(scenario_s - self.scenario_s[0], 0)
        after = np.maximum(scenario_s - self.scenario_s[-1], 0)
        return np.asarray(inside + self.slope * (before + after))

    def scenario(self, recorded_s: float, latest: bool = False) -> float:
        """Return the scenario time at which ``recorded_s`` is reached first, or left last."""
        if self.slope > 0:
            if recorded_s < self.recorded_s[0]:
                return float(self.scenario_s[0] - (self.recorded_s[0] - recorded_s) / self.slope)
            if recorded_s > self.recorded_s[-1]:
                return float(self.scenario_s[-1] + (recorded_s - self.recorded_s[-1]) / self.slope)
        index = int(np.searchsorted(self.recorded_s, recorded_s, side="right" if latest else "left"))
        reached = index - 1 if latest else index
        if self.recorded_s[min(reached, len(self.recorded_s) - 1)] == recorded_s:
            return float(self.scenario_s[reached])
        low, high = index - 1, index
        fraction = (recorded_s - self.recorded_s[low]) / (self.recorded_s[high] - self.recorded_s[low])
        return float(self.scenario_s[low] + fraction * (self.scenario_s[high] - self.scenario_s[low]))

    def clamped(self, first_s: float, last_s: float) -> TimeMap:
        """Return the map with its recorded times clipped to ``first_s`` to ``last_s``, seconds."""
        ends = [self.scenario(first_s), self.scenario(last_s, latest=True)]
        between = (self.scenario_s > ends[0]) & (self.scenario_s < ends[1])
        times = np.concatenate([[ends[0]], self.scenario_s[between], [ends[1]]])
        recorded = np.concatenate([[first_s], self.recorded_s[between], [last_s]])
        times, index = np.unique(times, return_index=True)  # an actor of one moment has one knot
        return TimeMap(times, recorded[index], slope=0.0)


def retimed(trajectory: Trajectory, time_map: TimeMap) -> Trajectory:
    """Return the trajectory that is, at every scenario time, where it was at the recorded time. Exact: keys wherever
    either has one."""
    if len(trajectory.times_s) == 1:
        return trajectory
    recorded = trajectory.times_s
    if len(time_map.scenario_s) == 1 and time_map.slope > 0:
        times = time_map.scenario_s[0] + (recorded - time_map.recorded_s[0]) / time_map.slope
        return Trajectory(times, trajectory.positions, trajectory.quaternions_wxyz)
    low, high = (-np.inf, np.inf) if time_map.slope > 0 else (time_map.recorded_s[0], time_map.recorded_s[-1])
    inside = recorded[(recorded >= low) & (recorded <= high)]
    # both ends of a stretch in which time stands still are knots, so the first time of each key will do
    reached = np.array([time_map.scenario(float(time)) for time in inside])
    ends = np.concatenate([reached, time_map.scenario_s])
    times = merged_times(time_map.scenario_s, reached, np.array([ends.min() - 1, ends.max() + 1]))
    source = time_map.recorded(times)
    nearest = inside[np.argmin(np.abs(reached[None] - times[:, None]), 1)] if len(inside) else source
    # a key that was reached stands at its own recorded time, not at one that rounding moved
    source = np.where(np.abs(nearest - source) < SAME_TIME_S, nearest, source)
    positions, quaternions = sampled_keys(trajectory, source)
    return Trajectory(times, positions, quaternions)


def beside(
    trajectory: Trajectory,
    offset_m: tuple[float, float, float] | None,
    world_offset_m: tuple[float, float, float] | None,
    turn_deg: float | None,
) -> Trajectory:
    """Return the trajectory displaced along its own axes and the world's, then turned about its own z."""
    if offset_m is not None:
        offset: FloatArray = np.array(offset_m, float)
        curve = offset_curve(trajectory, trajectory.times_s, lambda times: np.broadcast_to(offset, (len(times), 3)))
        trajectory = displaced(trajectory, curve)
    positions, quaternions = trajectory.positions, trajectory.quaternions_wxyz
    if world_offset_m is not None:
        positions = positions + np.array(world_offset_m, float)
    if turn_deg is not None:
        # a turn on the right passes through slerp, so the keys alone need it
        quaternions = quaternion_product(quaternions, quaternion_from_yaw(np.radians(turn_deg)))
    return Trajectory(trajectory.times_s, positions, quaternions)
