"""The world of a simulation at a moment, and the keys of the trajectories that led there."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..geometry import FloatArray, Quaternion, Trajectory, Vector3, quaternion_from_matrix
from ..world.captures import US_PER_SECOND
from .actors.model import ActorMotion
from .states import EgoState, Traffic
from .vehicle.actions import Control, Plan

KEY_HISTORY_S = 1.0
"""Seconds before its time from which a world has keys: no exposure that has not ended began earlier."""

JUMP_US = 1
"""Time between the two keys of a trajectory that jumps: it is there at once, and speeds do not come from the jump."""
CLOSE_S = 1e-7
"""Times that are closer are the same, in seconds."""


@dataclass(frozen=True)
class FollowLog:
    """The vehicle is where the recording has it: neither its dynamics nor a tracker take part."""


Action = Control | Plan | FollowLog


@dataclass(frozen=True, slots=True)
class PoseKey:
    """A pose at a time, seconds: position in metres, world frame, and unit quaternion. ``walked_m`` is the length of the path up
    to it (`Trajectory.walked_m`) in an actor's keys."""

    time_s: float
    position_m: Vector3
    quaternion_wxyz: Quaternion
    walked_m: float = 0.0

    @staticmethod
    def of(time_us: int, pose: FloatArray) -> PoseKey:
        return PoseKey.all_of([time_us], pose[None])[0]

    @staticmethod
    def all_of(times_us: Sequence[int], poses: FloatArray) -> list[PoseKey]:
        """Return the keys of poses (N, 4, 4)."""
        places, turns = poses[:, :3, 3].tolist(), quaternion_from_matrix(poses[:, :3, :3]).tolist()
        return [
            PoseKey(time_us / US_PER_SECOND, (x, y, z), (a, b, c, d))
            for time_us, (x, y, z), (a, b, c, d) in zip(times_us, places, turns, strict=True)
        ]

    @staticmethod
    def on(trajectory: Trajectory, time_us: int) -> PoseKey:
        """Return the key of a trajectory's pose at a time: its own key to the bit, where it has one there."""
        place, quaternion = trajectory.placed_at(time_us / US_PER_SECOND)
        x, y, z = place.tolist()
        a, b, c, d = quaternion.tolist()
        walked_m = float(trajectory.walked_at(time_us / US_PER_SECOND))
        return PoseKey(time_us / US_PER_SECOND, (x, y, z), (a, b, c, d), walked_m)


PoseKeys = tuple[PoseKey, ...]


@dataclass(frozen=True, eq=False)
class World:
    """The world at ``time_us``, integer microseconds from the log's first frame.

    ``ego_keys`` are the keys of the vehicle's trajectory of the last `KEY_HISTORY_S`, behind the one at which it came to rest
    where it stood then, none where it follows its log throughout; ``keys`` those of the actors that the simulation moves.
    ``strayed``: which of these have left their recorded trajectory, and ``vanished_s`` when such an actor left the world.
    ``action`` is what the vehicle follows; ``pending`` are actions that take effect later, each with its time.
    """

    time_us: int
    ego: EgoState
    traffic: Traffic
    motions: Mapping[str, ActorMotion]
    action: Action
    pending: tuple[tuple[int, Action], ...] = ()
    ego_keys: PoseKeys = ()
    keys: Mapping[str, PoseKeys] = field(default_factory=dict)
    strayed: frozenset[str] = frozenset()
    vanished_s: Mapping[str, float] = field(default_factory=dict)


def jumps(trajectory: Trajectory, time_s: float) -> bool:
    """Return whether a trajectory jumps at a time: it has a key there, and one `JUMP_US` before."""
    at = int(np.searchsorted(trajectory.times_s, time_s - CLOSE_S))
    if at == 0 or at == len(trajectory.times_s) or trajectory.times_s[at] > time_s + CLOSE_S:
        return False
    return bool(time_s - trajectory.times_s[at - 1] < JUMP_US / US_PER_SECOND + CLOSE_S)


def extended(keys: PoseKeys, new: Iterable[PoseKey], time_us: int, carries: bool = False) -> PoseKeys:
    """Return keys with new ones that lie behind them, less those that no exposure after ``time_us - KEY_HISTORY_S`` needs.
    ``carries``: they are of the vehicle, and sensors ride on it (`since_rest`)."""
    last = keys[-1].time_s if keys else None
    joined = list(keys)
    for key in new:
        if last is None or key.time_s > last:
            joined.append(key if carries or not joined else _walked_on(joined[-1], key))
    recent = keys_from(tuple(joined), time_us / US_PER_SECOND - KEY_HISTORY_S)
    return since_rest(tuple(joined), recent) if carries else recent


def _walked_on(before: PoseKey, key: PoseKey) -> PoseKey:
    (x0, y0, _), (x1, y1, _) = before.position_m, key.position_m
    return replace(key, walked_m=before.walked_m + math.hypot(x1 - x0, y1 - y0))


def keys_from(keys: PoseKeys, time_s: float) -> PoseKeys:
    """Return the keys that poses from a time on depend on: those after it, and the last one before."""
    first = next((i for i, key in enumerate(keys) if key.time_s >= time_s), len(keys) - 1)
    return keys[max(first - 1, 0) :]


def since_rest(keys: PoseKeys, recent: PoseKeys) -> PoseKeys:
    """Return ``recent``, the last ones of ``keys``, behind the key at which what they begin with came to rest: sensors stand on a
    vehicle as they did then."""
    first = reached = len(keys) - len(recent)
    while reached > 0 and same_pose(keys[reached - 1], keys[first]):
        reached -= 1
    return recent if reached == first else (keys[reached], *recent)


def same_pose(a: PoseKey, b: PoseKey) -> bool:
    """Return whether two keys have the same pose, to the bit."""
    return (a.position_m, a.quaternion_wxyz) == (b.position_m, b.quaternion_wxyz)


def recorded_keys(trajectory: Trajectory, after_s: float | None, before_s: float) -> PoseKeys:
    """Return a recorded trajectory's own keys between two times, both excluded, to the bit; with None all that lie before."""
    times = trajectory.times_list
    first = 0 if after_s is None else bisect_right(times, after_s)
    return tuple(
        PoseKey(
            times[at],
            tuple(trajectory.positions[at].tolist()),
            tuple(trajectory.quaternions_wxyz[at].tolist()),
            float(trajectory.walked_m[at]),
        )
        for at in range(first, bisect_left(times, before_s))
    )
