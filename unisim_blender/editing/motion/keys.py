"""Keys of trajectories: along a drawn line, shifted along their own path by arc length (so
that what turns is shifted round the turn), dense enough that Blender's interpolation gives the recorded motion, and
dragged by handles in a view."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ...core.geometry import FloatArray, Trajectory, quaternion_from_matrix
from ...core.scenario.motion.paths import shifted_along
from ...core.scenario.motion.trajectories import merged_times, sampled_keys
from ..sampled.clock import Clock


class TrajectoryKeys(NamedTuple):
    """Keys of a trajectory: frames (K,), positions (K, 3) in the world, unit quaternions wxyz (K, 4)."""

    frames: FloatArray
    positions: FloatArray
    quaternions: FloatArray


def along_line(line: FloatArray, at: FloatArray, height_m: float) -> TrajectoryKeys:
    """Return a trajectory along a line (P, 3) with keys at arc lengths (K,) in metres, for a box of a height whose
    underside is on the line.

    ``frames`` are the arc lengths. The front is ahead, the left side level.
    """
    apart = np.linalg.norm(np.diff(line, axis=0), axis=1)
    line = line[np.concatenate([[True], apart > 1e-6])]
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    positions = np.stack([np.interp(at, along, column) for column in line.T], -1)
    reach = min(1.0, along[-1] / 4)
    ahead = np.stack([np.interp(at + reach, along, c) - np.interp(at - reach, along, c) for c in line.T], -1)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.cross([0.0, 0.0, 1.0], ahead)
    left /= np.linalg.norm(left, axis=1, keepdims=True)
    up = np.cross(ahead, left)
    return TrajectoryKeys(at, positions + up * height_m / 2, quaternion_from_matrix(np.stack([ahead, left, up], -1)))


def extended(at_s: FloatArray, times_s: FloatArray, positions: FloatArray) -> FloatArray:
    """Return places (N, 3) at times (N,) of a trajectory, keys at times (K,) and positions (K, 3): straight on beyond its
    ends."""
    inside = np.stack([np.interp(at_s, times_s, column) for column in positions.T], -1)
    if len(times_s) < 2:
        return inside
    first, last = np.diff(positions[:2], axis=0) / (times_s[1] - times_s[0]), positions[-1] - positions[-2]
    before, after = np.minimum(at_s - times_s[0], 0.0)[:, None], np.maximum(at_s - times_s[-1], 0.0)[:, None]
    return np.asarray(inside + before * first + after * last / (times_s[-1] - times_s[-2]))


TURN_RAD = 0.02
"""Between two keys: what Blender makes of it is 1e-6 rad off slerp."""
OFF_M = 1e-5
BLEND_S = 2.0
"""Time before and after its key at which a displacement with auto-keying begins and ends, in seconds."""
SAME = 1e-5


def dense(trajectory: Trajectory, clock: Clock) -> Trajectory:
    """Return the same trajectory with keys at all frames besides, where Blender would interpolate its own keys
    otherwise: it turns by other numbers than slerp, and a log's frames are not quite evenly spaced."""
    q = continuous(trajectory.quaternions_wxyz)
    turns = np.abs((q[1:] * q[:-1]).sum(-1)).min() < np.cos(TURN_RAD / 2)
    keys = clock.frame(trajectory.times_s)
    inside = (clock.frames >= keys[0]) & (clock.frames <= keys[-1])
    true = trajectory.at(clock.times_s[inside])
    interpolated = np.stack([np.interp(clock.frames[inside], keys, column) for column in trajectory.positions.T], -1)
    if not turns and np.abs(interpolated - true[:, :3, 3]).max(initial=0.0) < OFF_M:
        return trajectory
    times = merged_times(trajectory.times_s, clock.times_s)
    positions, quaternions = sampled_keys(trajectory, times)
    return Trajectory(times, positions, quaternions)


def hidden_keys(clock: Clock, present_s: tuple[float, float] | None) -> tuple[FloatArray, FloatArray] | None:
    """Frames and values of `hide_viewport`; None where the object is there at all of the clock's frames."""
    if present_s is None:
        return None
    there = (clock.times_s >= present_s[0]) & (clock.times_s <= present_s[1])
    if there.all():
        return None
    frames, hidden = [clock.frames[0] - 1], [1.0]
    for frame, here in zip(clock.frames, there, strict=True):
        if hidden[-1] != (0.0 if here else 1.0):
            frames.append(frame)
            hidden.append(0.0 if here else 1.0)
    if there[-1]:
        frames.append(clock.frames[-1] + 1)
        hidden.append(1.0)
    return np.array(frames), np.array(hidden)


def continuous(quaternions: FloatArray) -> FloatArray:
    """Quaternions (K, 4) with signs such that neighbours lie on one side: Blender interpolates their numbers."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(-1) < 0, -1.0, 1.0)
    return quaternions * np.concatenate([[1.0], np.cumprod(flips)])[:, None]


SAME_FRAME = 1e-6
"""Keys nearer than this to each other are one."""


def shifted_keys(
    frames: FloatArray, positions: FloatArray, quaternions: FloatArray, whole: FloatArray, ahead_m: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return keys at frames (K,), positions (K, 3) and quaternions (K, 4), moved along their path, with keys at the
    ``whole`` frames (N,) between them too: between two keys the path may turn at what was a key before."""
    inside = whole[(whole > frames[0]) & (whole < frames[-1])]
    every = np.unique(np.concatenate([frames, inside]))
    every = every[np.concatenate([[True], np.diff(every) > SAME_FRAME])]
    return every, *shifted_along(_at(every, frames, positions), _unit(_at(every, frames, quaternions)), ahead_m)


def _at(wanted: FloatArray, frames: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(wanted, frames, column) for column in values.T], -1)


def _unit(quaternions: FloatArray) -> FloatArray:
    return np.asarray(quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))


def on_plane(origin: FloatArray, direction: FloatArray, point: FloatArray, normal: FloatArray) -> FloatArray | None:
    """Return where a ray hits the plane through a point; None where it runs along it or away from it."""
    along = float(direction @ normal)
    if abs(along) < 1e-6:
        return None
    away = float((point - origin) @ normal) / along
    return None if away <= 0 else np.asarray(origin + away * direction)


def along_axis(origin: FloatArray, direction: FloatArray, point: FloatArray, line: FloatArray) -> float:
    """Return how far from a point along a unit ``line`` (3,) that line is nearest to a ray."""
    unit = direction / np.linalg.norm(direction)
    across = float(unit @ line)
    apart = origin - point
    return float((apart @ line - across * (apart @ unit)) / max(1 - across**2, 1e-9))


def stepped(value: float, step: float, in_steps: bool) -> float:
    """Return a value, in steps where that is asked for."""
    return round(value / step) * step if in_steps else value


HANDLE_LIMIT = 24
"""Handles of one trajectory: of a long drive every second, fifth, or tenth whole second has one."""
STEPS_S = (1.0, 2.0, 5.0, 10.0, 20.0, 60.0)
NEAR = 0.3
"""Whole seconds nearer than this share of a step to a key have no handle of their own."""


@dataclass(frozen=True)
class Handle:
    """A time on a trajectory, in seconds of the log, the place (3,) in the world there, and whether a key
    displaces it there."""

    time_s: float
    place: FloatArray
    is_key: bool


def handle_times(key_times_s: FloatArray, span_s: tuple[float, float]) -> list[tuple[float, bool]]:
    """Return the times of handles in order, and whether a key is there.

    There is one at each key (K,) within the span from when to when the actor is present, and at whole seconds, in a
    long span at each second, fifth or tenth one, so that there are at most about `HANDLE_LIMIT`.
    """
    start, end = span_s
    keyed = sorted({round(float(time), 4) for time in key_times_s if start <= time <= end})[:HANDLE_LIMIT]
    step = next((s for s in STEPS_S if (end - start) / s + len(keyed) <= HANDLE_LIMIT), STEPS_S[-1])
    whole = np.arange(np.ceil(start / step - 1e-6), np.floor(end / step + 1e-6) + 1) * step
    free = [float(time) for time in whole if all(abs(time - key) > NEAR * step for key in keyed)]
    return sorted([(time, True) for time in keyed] + [(time, False) for time in free])
