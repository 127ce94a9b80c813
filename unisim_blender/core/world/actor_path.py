"""Paths of actors by arc length: poses, recorded speeds and stops; and paths that lead from a pose to another path,
smooth in position and heading.

Arc length is measured in the world's plane. A path is linear in position and slerp in rotation between its keys, as the
trajectory is, and goes straight on beyond its end."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..geometry import (
    BoolArray,
    FloatArray,
    Quaternion,
    Trajectory,
    Vector3,
    quaternion_from_yaw,
    quaternion_product,
    slerp,
)
from .polyline import Polyline, spaced

MIN_KEY_DISTANCE_M = 0.2
"""Smallest distance between keys, metres: nearer ones wander by the labels' noise, which would add to the path's
length."""
MIN_MOVING_LENGTH_M = 1.0
"""Shortest path of an actor that counts as moving, metres."""
MIN_STOP_S = 1.0
"""Shortest time within `MIN_KEY_DISTANCE_M` that counts as a stop, seconds."""
STANDING_SPEED_M_S = 0.3
"""Speed below which an actor stands, metres per second."""
SPEED_WINDOW_S = 0.25
"""Time before and after, seconds, over which recorded speeds are means: differences of single keys are mostly noise."""
STOP_TOLERANCE_M = 0.5
"""Largest distance, metres, by which a stop may lie behind and still be stood at."""
END_SLOPE_LENGTH_M = 20.0
"""Length, metres, of the last part of a path, whose slope continues beyond the end."""
MAX_SLOPE = 0.2
_FAR_M = 1e6


@dataclass(frozen=True)
class Stop:
    """A place of a path where the recording stood, until ``leave_s``; infinity where it stood to the end."""

    s_m: float
    leave_s: float


@dataclass(frozen=True, eq=False)
class ActorPath:
    """Poses by arc length.

    ``s_m`` (N,) strictly increasing from 0, N >= 2; ``positions`` (N, 3) of the box's centre and ``quaternions_wxyz``
    (N, 4), world frame; ``speeds_m_s`` (N,) recorded there. ``arrivals_s`` and ``leaves_s`` (M,), M <= N: when the
    recording came to its first M keys, and when it left them; none for a path that nobody drove. ``ends``: whether its
    actor leaves the world at its end.
    """

    s_m: FloatArray
    positions: FloatArray
    quaternions_wxyz: FloatArray
    speeds_m_s: FloatArray
    stops: tuple[Stop, ...] = ()
    arrivals_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    leaves_s: FloatArray = field(default_factory=lambda: np.zeros(0))
    ends: bool = False

    @staticmethod
    def recorded(trajectory: Trajectory, start_s: float, end_s: float, ends: bool) -> ActorPath | None:
        """Return the path of a trajectory between two times; None where it stands all along."""
        inside = trajectory.times_s[(trajectory.times_s > start_s) & (trajectory.times_s < end_s)]
        times = np.concatenate([[start_s], inside, [end_s]]) if end_s > start_s else np.array([start_s])
        positions, quaternions = trajectory.placed_at(times)
        keys = _apart(positions, times)
        distances = np.linalg.norm(np.diff(positions[keys, :2], axis=0), axis=1)
        if distances.sum() < MIN_MOVING_LENGTH_M:
            return None
        s = np.concatenate([[0.0], np.cumsum(distances)])
        leaves = _leaves(trajectory, times, keys, start_s, end_s)
        arrivals = times[keys]
        speeds = recorded_speeds(trajectory, arrivals, start_s, end_s)
        stops = [
            Stop(float(s[key]), math.inf if key == len(keys) - 1 else float(leaves[key]))
            for key in range(len(keys))
            if leaves[key] - arrivals[key] >= MIN_STOP_S
        ]
        return ActorPath(s, positions[keys], quaternions[keys], speeds, tuple(stops), arrivals, leaves, ends)

    @staticmethod
    def straight(position: Vector3, heading_rad: float, length_m: float = 10.0) -> ActorPath:
        """Return the level path straight on from a place, on which nothing was recorded: its speeds are 0."""
        end = np.array(position) + length_m * np.array([math.cos(heading_rad), math.sin(heading_rad), 0.0])
        both = np.broadcast_to(quaternion_from_yaw(heading_rad), (2, 4))
        return ActorPath(np.array([0.0, length_m]), np.stack([np.array(position), end]), both, np.zeros(2))

    @property
    def length_m(self) -> float:
        return float(self.s_m[-1])

    @cached_property
    def headings_rad(self) -> FloatArray:
        """Headings (N,) of the boxes, without steps of a turn."""
        return np.unwrap(yaw_of(self.quaternions_wxyz))

    @cached_property
    def _gears(self) -> list[int]:
        """For each part between two keys: 1 where the box moves along its heading, -1 where it moves backward."""
        ahead = np.diff(self.positions[:, :2], axis=0)
        middle = (self.headings_rad[:-1] + self.headings_rad[1:]) / 2
        along = ahead[:, 0] * np.cos(middle) + ahead[:, 1] * np.sin(middle)
        return [1 if step >= 0 else -1 for step in along.tolist()]

    @cached_property
    def _end(self) -> tuple[FloatArray, float]:
        """The direction (3,) of the way beyond the end, of length 1 in the plane, and its heading."""
        heading, gear = float(self.headings_rad[-1]), self._gears[-1]
        first = float(np.interp(max(self.length_m - END_SLOPE_LENGTH_M, 0.0), self.s_m, self.positions[:, 2]))
        run = min(self.length_m, END_SLOPE_LENGTH_M)
        slope = (float(self.positions[-1, 2]) - first) / run if run >= END_SLOPE_LENGTH_M / 2 else 0.0
        slope = min(max(slope, -MAX_SLOPE), MAX_SLOPE)
        return np.array([gear * math.cos(heading), gear * math.sin(heading), slope]), heading

    @cached_property
    def _lists(self) -> tuple[list[float], list[list[float]], list[list[float]], list[float]]:
        """The arrays as lists, in which a single value is looked up faster."""
        arrays = self.s_m, self.positions, self.quaternions_wxyz, self.speeds_m_s
        return tuple(array.tolist() for array in arrays)

    @cached_property
    def _plane(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Arc lengths, places and headings with a key far beyond the end, so that interpolation goes straight on."""
        far = self.positions[-1] + _FAR_M * self._end[0]
        return (
            np.append(self.s_m, self.length_m + _FAR_M),
            np.append(self.positions[:, 0], far[0]),
            np.append(self.positions[:, 1], far[1]),
            np.append(self.headings_rad, self._end[1]),
        )

    @cached_property
    def lines(self) -> FloatArray:
        """The lines (7, N) that the path consists of in the plane: arc lengths of their starts, places and headings
        there, and the changes of these three by arc length. The last one goes straight on beyond the end."""
        s, *columns = self._plane
        values = np.stack(columns)
        return np.concatenate([s[None, :-1], values[:, :-1], np.diff(values) / np.diff(s)])

    @property
    def keys(self) -> list[float]:
        """The arc lengths as a list, which is faster to search."""
        return self._lists[0]

    def prepare(self) -> None:
        """Compute the cached properties."""
        _ = self.lines, self._lists, self._gears, self._schedule

    def place(self, s_m: float) -> tuple[Vector3, Quaternion]:
        """Return the pose at an arc length: position and quaternion. Before the start it is the start."""
        keys, positions, quaternions, _ = self._lists
        if s_m >= keys[-1]:
            (x, y, z), (ahead_x, ahead_y, ahead_z), beyond = positions[-1], self._end[0].tolist(), s_m - keys[-1]
            w, i, j, k = quaternions[-1]
            return (x + beyond * ahead_x, y + beyond * ahead_y, z + beyond * ahead_z), (w, i, j, k)
        lower = max(bisect_right(keys, s_m) - 1, 0)
        u = max((s_m - keys[lower]) / (keys[lower + 1] - keys[lower]), 0.0)
        (ax, ay, az), (bx, by, bz) = positions[lower], positions[lower + 1]
        turned = _slerp(quaternions[lower], quaternions[lower + 1], u)
        return (ax + u * (bx - ax), ay + u * (by - ay), az + u * (bz - az)), turned

    def point(self, s_m: float) -> tuple[float, float]:
        """Return the place in the plane at an arc length, as `place` has it."""
        keys, positions, _, _ = self._lists
        if s_m >= keys[-1]:
            (x, y, _), direction, beyond = positions[-1], self._end[0].tolist(), s_m - keys[-1]
            return x + beyond * direction[0], y + beyond * direction[1]
        lower = max(bisect_right(keys, s_m) - 1, 0)
        u = max((s_m - keys[lower]) / (keys[lower + 1] - keys[lower]), 0.0)
        (ax, ay, _), (bx, by, _) = positions[lower], positions[lower + 1]
        return ax + u * (bx - ax), ay + u * (by - ay)

    def places(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return `place` of arc lengths (K,): positions (K, 3) and quaternions (K, 4)."""
        lower = np.clip(np.searchsorted(self.s_m, s_m, side="right") - 1, 0, len(self.s_m) - 2)
        u = np.clip((s_m - self.s_m[lower]) / (self.s_m[lower + 1] - self.s_m[lower]), 0.0, 1.0)
        positions = self.positions[lower] + u[:, None] * (self.positions[lower + 1] - self.positions[lower])
        beyond = np.maximum(s_m - self.length_m, 0.0)
        quaternions = slerp(self.quaternions_wxyz[lower], self.quaternions_wxyz[lower + 1], u)
        return positions + beyond[:, None] * self._end[0], quaternions

    def speed_at(self, s_m: float) -> float:
        """Return the recorded speed at an arc length, that of the end beyond it."""
        keys, _, _, speeds = self._lists
        if s_m >= keys[-1]:
            return speeds[-1]
        lower = max(bisect_right(keys, s_m) - 1, 0)
        u = max((s_m - keys[lower]) / (keys[lower + 1] - keys[lower]), 0.0)
        return speeds[lower] + u * (speeds[lower + 1] - speeds[lower])

    def gear_at(self, s_m: float) -> int:
        """Return 1 where the box moves along its heading, -1 where it moves backward."""
        return self._gears[min(max(bisect_right(self._lists[0], s_m) - 1, 0), len(self._gears) - 1)]

    def curvature_at(self, s_m: float) -> float:
        """Return the heading's change by arc length, 1/m, left positive; 0 beyond the end."""
        keys = self._lists[0]
        if s_m >= keys[-1]:
            return 0.0
        lower = max(bisect_right(keys, s_m) - 1, 0)
        return float((self.headings_rad[lower + 1] - self.headings_rad[lower]) / (keys[lower + 1] - keys[lower]))

    def headings_at(self, s_m: FloatArray) -> FloatArray:
        """Return the headings (...) at arc lengths (...), without steps of a turn."""
        return np.asarray(np.interp(s_m, self._plane[0], self._plane[3]))

    def s_at_time(self, time_s: float) -> float:
        """Return the arc length at which the recording was at a time; that of its ends before and after it."""
        return float(np.interp(time_s, *self._schedule))

    @cached_property
    def _schedule(self) -> tuple[FloatArray, FloatArray]:
        """Times at which the recording came to its keys and left them, and their arc lengths."""
        times = np.stack([self.arrivals_s, self.leaves_s], 1).ravel()
        return times, np.repeat(self.s_m[: len(self.arrivals_s)], 2)

    def project(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return the arc length of the place of the path nearest to the point (``x_m``, ``y_m``) of the world's plane,
        and the distance by which the point lies to its left, metres."""
        projection = self._line.project(x_m, y_m)
        return projection.along_m, self._gears[min(projection.segment, len(self._gears) - 1)] * projection.left_m

    @cached_property
    def _line(self) -> Polyline:
        return Polyline(self.positions[:, :2], self.s_m, after=self._end[0][:2])

    def at_speed(self, speed_m_s: float) -> ActorPath:
        """Return the path with one speed all along, without stops and without an end."""
        return replace(self, speeds_m_s=np.full(len(self.s_m), speed_m_s), stops=(), ends=False)

    def then(self, further: ActorPath) -> ActorPath:
        """Return this path continued by another one, which starts at its end."""
        return replace(
            self,
            s_m=np.concatenate([self.s_m, self.length_m + further.s_m[1:]]),
            positions=np.concatenate([self.positions, further.positions[1:]]),
            quaternions_wxyz=np.concatenate([self.quaternions_wxyz, further.quaternions_wxyz[1:]]),
            speeds_m_s=np.concatenate([self.speeds_m_s, further.speeds_m_s[1:]]),
            stops=(*self.stops, *(replace(stop, s_m=self.length_m + stop.s_m) for stop in further.stops)),
            ends=further.ends,
        )


def yaw_of(quaternions_wxyz: FloatArray) -> FloatArray:
    """Return the headings (...) of quaternions (..., 4): those of their x axes in the world's plane."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions_wxyz, np.float64), -1, 0)
    return np.asarray(np.arctan2(2 * (x * y + w * z), 1 - 2 * (y * y + z * z)))


def recorded_speeds(trajectory: Trajectory, times_s: FloatArray, start_s: float, end_s: float) -> FloatArray:
    """Return the speeds (T,) in the plane at times (T,): means over `SPEED_WINDOW_S` before and after, within two
    times."""
    if end_s <= start_s:
        return np.zeros(len(times_s))
    before = np.clip(times_s - SPEED_WINDOW_S, start_s, end_s)
    after = np.clip(times_s + SPEED_WINDOW_S, start_s, end_s)
    moved = trajectory.positions_at(after) - trajectory.positions_at(before)
    return np.asarray(np.hypot(moved[:, 0], moved[:, 1]) / (after - before))


def _apart(positions: FloatArray, times_s: FloatArray) -> NDArray[np.int64]:
    """Return indices of positions (T, 3) that are `MIN_KEY_DISTANCE_M` or more apart, and that of the last position,
    unless the recording stands there."""
    keys = spaced(positions[:, :2], MIN_KEY_DISTANCE_M)
    rest = float(np.linalg.norm(positions[-1, :2] - positions[keys[-1], :2]))
    if rest > 1e-3 and times_s[-1] - times_s[keys[-1]] < MIN_STOP_S:
        return np.append(keys, len(positions) - 1)
    return keys


def _leaves(
    trajectory: Trajectory, times_s: FloatArray, keys: NDArray[np.int64], start_s: float, end_s: float
) -> FloatArray:
    """Return when the recording left each kept key: when it last stood before it came to the next one."""
    stands: BoolArray = recorded_speeds(trajectory, times_s, start_s, end_s) < STANDING_SPEED_M_S
    leaves = times_s[keys].copy()
    for key, (first, end) in enumerate(zip(keys, [*keys[1:], len(times_s)], strict=True)):
        last = np.flatnonzero(stands[first:end])
        if len(last):
            after = times_s[min(end, len(times_s) - 1)]
            leaves[key] = min(times_s[first + last[-1]] + SPEED_WINDOW_S, after)
    return leaves


def _slerp(a: Sequence[float], b: Sequence[float], u: float) -> Quaternion:
    """Return `geometry.slerp` of single quaternions, without arrays."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    dot = aw * bw + ax * bx + ay * by + az * bz
    sign = -1.0 if dot < 0 else 1.0
    angle = math.acos(min(abs(dot), 1.0))
    sine = math.sin(angle)
    near = sine < 1e-6
    p = 1 - u if near else math.sin((1 - u) * angle) / sine
    q = sign * (u if near else math.sin(u * angle) / sine)
    w, x, y, z = p * aw + q * bw, p * ax + q * bx, p * ay + q * by, p * az + q * bz
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm


_KEY_SPACING_M = 0.5
_MAX_JOIN_ANGLE_RAD = 0.6
"""A join starts at this angle to its path at most; what is beyond is turned along the way."""


def joined(
    path: ActorPath, s_m: float, position: Vector3, quaternion_wxyz: Quaternion, length_m: float, left_m: float = 0.0,
    keeps_height: bool = False,
) -> ActorPath:  # fmt: skip
    """Return the path from a pose to ``left_m`` left of ``path``, which it reaches ``length_m`` beyond arc length
    ``s_m``.

    The distance to the left is a quintic of arc length that starts in the pose's direction and ends along the path,
    both without curvature of its own. ``keeps_height``: the height above the path stays what it is at the start;
    otherwise it, and always what the pose has of roll and pitch, goes over into the path's.
    """
    count = max(int(math.ceil(length_m / _KEY_SPACING_M)), 2)
    inner = s_m + np.arange(count + 1) * (length_m / count)
    beyond = path.s_m[path.s_m > inner[-1] + 1e-3]
    at = np.concatenate([inner, beyond])
    positions, quaternions = path.places(at)
    headings, gear = path.headings_at(at), path.gear_at(s_m)

    offset = np.array(position) - positions[0]
    sine, cosine = math.sin(headings[0]), math.cos(headings[0])
    left_0, ahead_0 = cosine * offset[1] - sine * offset[0], cosine * offset[0] + sine * offset[1]
    turn_0 = math.remainder(float(yaw_of(np.array(quaternion_wxyz))) - headings[0], math.tau)
    turn_0 = min(max(turn_0, -_MAX_JOIN_ANGLE_RAD), _MAX_JOIN_ANGLE_RAD)

    u = np.clip((at - s_m) / length_m, 0.0, 1.0)
    left, slope = quintic(u, left_0 - left_m, gear * math.tan(turn_0) * length_m)
    fade = quintic(u, 1.0, 0.0)[0]
    sines, cosines = np.sin(headings), np.cos(headings)
    side = (left_m + left)[:, None] * np.stack([-sines, cosines], -1)
    along = (ahead_0 * fade)[:, None] * np.stack([cosines, sines], -1)
    raised = offset[2] if keeps_height else offset[2] * fade
    new = positions + np.concatenate([side + along, np.broadcast_to(raised, len(at))[:, None]], -1)
    turned = quaternion_product(quaternion_from_yaw(gear * np.arctan(slope / length_m)), quaternions)
    rest = quaternion_product(np.array(quaternion_wxyz), turned[0] * [1, -1, -1, -1])
    turned = quaternion_product(
        slerp(np.broadcast_to([1.0, 0, 0, 0], turned.shape), np.broadcast_to(rest, turned.shape), fade), turned
    )
    new[0], turned[0] = position, quaternion_wxyz

    lengths = np.linalg.norm(np.diff(new[:, :2], axis=0), axis=1)
    distinct = np.concatenate([[True], lengths > 1e-6])
    s = np.concatenate([[0.0], np.cumsum(lengths)])
    speeds = np.interp(at, path.s_m, path.speeds_m_s)
    stops = tuple(
        replace(stop, s_m=float(np.interp(stop.s_m, at, s)))
        for stop in path.stops
        if stop.s_m >= s_m - STOP_TOLERANCE_M
    )
    return ActorPath(s[distinct], new[distinct], turned[distinct], speeds[distinct], stops, ends=path.ends)


def quintic(u: FloatArray, start: float, slope: float) -> tuple[FloatArray, FloatArray]:
    """Return the quintic Hermite polynomial on [0, 1] and its derivative that start at a value with a slope and without
    curvature, and end at 0 flat and straight."""
    u2, u3 = u * u, u**3
    u4, u5 = u2 * u2, u2 * u3
    value = start * (1 - 10 * u3 + 15 * u4 - 6 * u5) + slope * (u - 6 * u3 + 8 * u4 - 3 * u5)
    derivative = start * (-30 * u2 + 60 * u3 - 30 * u4) + slope * (1 - 18 * u2 + 32 * u3 - 15 * u4)
    return value, derivative
