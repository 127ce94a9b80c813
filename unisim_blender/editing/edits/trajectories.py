"""Motion of objects as a scenario writes it: keyframes, placements, when an object is present."""

from __future__ import annotations

import numpy as np

from ...core.geometry import (
    BoolArray,
    FloatArray,
    Quaternion,
    Trajectory,
    Vector3,
    matrix_from_quaternion,
    quaternion_from_matrix,
)
from ...core.scenario.motion.keys import Keyframe, Present
from ...core.scenario.motion.placement import Placement
from ...core.scenario.motion.trajectories import SAME_TIME_S
from ..sampled.clock import Clock
from ..sampled.scene import same

DIGITS = 7
"""Of metres and of quaternions: what Blender's float32 can tell, and two digits more."""


def pose_or_trajectory(
    clock: Clock, poses: FloatArray, there: BoolArray, recorded: Trajectory | None = None
) -> dict[str, Placement | tuple[Keyframe, ...]]:
    """The member ``pose`` or ``trajectory`` of an edit, from an object's poses (N, 4, 4) at the frames at which
    it is there (N,).

    ``recorded`` is the trajectory that was edited: its keys between frames are kept.
    """
    at = np.flatnonzero(there)
    if same(poses[at], poses[at[:1]]).all():
        return {"pose": placement(poses[at[0]])}
    return {"trajectory": keyframes(clock, poses, there, recorded)}


def keyframes(
    clock: Clock, poses: FloatArray, there: BoolArray, recorded: Trajectory | None = None
) -> tuple[Keyframe, ...]:
    """A key for each frame at which an object is there, and for each key of ``recorded`` between them.

    Where a pose is the recorded one, its key has the recorded numbers. A key between frames is the recorded one with
    the displacement and the rotation interpolated from the frames next to it.
    """
    assert poses.shape == (len(clock.frames), 4, 4), (poses.shape, len(clock.frames))
    at = np.flatnonzero(there)
    times, positions = clock.times_s[at], poses[at, :3, 3]
    quaternions = quaternion_from_matrix(poses[at, :3, :3])
    frames: list[int | None] = [int(clock.frames[i]) for i in at]
    if recorded is not None and len(recorded.times_s) > 1:
        base = recorded.at(times)
        unedited = same(poses[at], base)
        positions[unedited] = base[unedited, :3, 3]
        quaternions[unedited] = quaternion_from_matrix(base[unedited, :3, :3])
        inside = (recorded.times_s > times[0] + SAME_TIME_S) & (recorded.times_s < times[-1] - SAME_TIME_S)
        between = recorded.times_s[inside & (np.abs(recorded.times_s[:, None] - times).min(1) > SAME_TIME_S)]
        if len(between):
            turns = np.swapaxes(base[:, :3, :3], -1, -2) @ matrix_from_quaternion(quaternions)
            apart = Trajectory(times, positions - base[:, :3, 3], quaternion_from_matrix(turns)).at(between)
            then = recorded.at(between)
            positions = np.concatenate([positions, then[:, :3, 3] + apart[:, :3, 3]])
            quaternions = np.concatenate([quaternions, quaternion_from_matrix(then[:, :3, :3] @ apart[:, :3, :3])])
            times, frames = np.concatenate([times, between]), frames + [None] * len(between)
    return tuple(
        Keyframe(
            frame=frames[i],
            time_s=None if frames[i] is not None else float(times[i]),
            position=vector(positions[i]),
            quaternion_wxyz=quaternion(quaternions[i]),
        )
        for i in np.argsort(times)
    )


def placement(pose: FloatArray) -> Placement:
    """A pose (4, 4) to stand at."""
    return Placement(position=vector(pose[:3, 3]), quaternion_wxyz=quaternion(quaternion_from_matrix(pose[:3, :3])))


def present(clock: Clock, there: BoolArray) -> Present | None:
    """When an object is there; None for throughout. A scenario knows one span, from the first such
    frame to the last."""
    if there.all():
        return None
    at = clock.times_s[there]
    return Present(None if there[0] else float(at[0]), None if there[-1] else float(at[-1]))


def vector(values: FloatArray) -> Vector3:
    """Three numbers as they are worth writing."""
    x, y, z = (float(v) for v in np.round(values, DIGITS))
    return x, y, z


def quaternion(values: FloatArray) -> Quaternion:
    """Four numbers as they are worth writing."""
    w, x, y, z = (float(v) for v in np.round(values, DIGITS))
    return w, x, y, z
