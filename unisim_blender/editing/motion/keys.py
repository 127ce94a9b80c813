"""Keys of a trajectory and of an object's presence, such that Blender's interpolation gives the recorded motion."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray, Trajectory
from ...core.scenario.motion.trajectories import merged_times, sampled_keys
from ..sampled.clock import Clock

TURN_RAD = 0.02
"""Between two keys: what Blender makes of it is 1e-6 rad off slerp."""
OFF_M = 1e-5
BLEND_S = 2.0
"""How long before and after its key a displacement with auto-keying begins and ends, in seconds."""
SAME = 1e-5


def dense(trajectory: Trajectory, clock: Clock) -> Trajectory:
    """Return the same trajectory with keys at all frames besides, where Blender would interpolate its own keys
    otherwise: it turns by other numbers than slerp, and a log's frames are not quite evenly spaced."""
    q = continuous(trajectory.quaternions_wxyz)
    turns = np.abs((q[1:] * q[:-1]).sum(-1)).min() < np.cos(TURN_RAD / 2)
    keys = clock.frame(trajectory.times_s)
    inside = (clock.frames >= keys[0]) & (clock.frames <= keys[-1])
    true = trajectory.at(clock.times_s[inside])
    made = np.stack([np.interp(clock.frames[inside], keys, column) for column in trajectory.positions.T], -1)
    if not turns and np.abs(made - true[:, :3, 3]).max(initial=0.0) < OFF_M:
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
