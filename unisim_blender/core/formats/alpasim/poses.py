"""Poses and trajectories of AlpaSim's messages, whose numbers are float32: a place 100 m away is exact to 8 micrometres."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray, Trajectory, make_pose, quaternion_from_matrix, transform_points
from .protos import FieldError, LidarSweep, common


def sweep_message(
    name: str, time_us: int, rig_from_lidar: FloatArray, points: FloatArray, intensity: NDArray[np.float32]
) -> Any:
    """Return a sweep's message: ``points`` (N, 3) in the LiDAR's frame at ``time_us``, ``intensity`` (N,) from 0 to 1. The
    message has points in the rig's frame."""
    rows = np.column_stack([transform_points(rig_from_lidar, points), intensity]).astype("<f4")
    return LidarSweep(
        logical_id=name,
        timestamp_us=time_us,
        rig_to_lidar=pose_message(rig_from_lidar),
        num_points=len(rows),
        points_xyzi=rows.tobytes(),
    )


FARTHEST_M = 1e6
"""No pose is farther from the world's origin along an axis."""


def vector_message(vector: Iterable[float]) -> Any:
    """Return the message of x, y and z."""
    x, y, z = (float(one) for one in vector)
    return common.Vec3(x=x, y=y, z=z)


def pose_message(pose: FloatArray) -> Any:
    """Return the message of a pose (4, 4)."""
    w, x, y, z = quaternion_from_matrix(pose[:3, :3]).tolist()
    return common.Pose(vec=vector_message(pose[:3, 3]), quat=common.Quat(w=w, x=x, y=y, z=z))


def trajectory_message(times_us: Iterable[int], poses: Iterable[FloatArray]) -> Any:
    """Return the message of poses (4, 4) at times, integer microseconds."""
    keys = zip(times_us, poses, strict=True)
    return common.Trajectory(
        poses=[common.PoseAtTime(pose=pose_message(pose), timestamp_us=time_us) for time_us, pose in keys]
    )


def pose_of(message: Any, field: str) -> FloatArray:
    """Return the pose (4, 4) of a message. Raises `FieldError` where a number is not finite or the quaternion has no length."""
    vec, quat = message.vec, message.quat
    position = np.array([vec.x, vec.y, vec.z], np.float64)
    quaternion = np.array([quat.w, quat.x, quat.y, quat.z], np.float64)
    if not np.isfinite(position).all() or np.abs(position).max() > FARTHEST_M:
        raise FieldError(f"{field}.vec", f"must be finite numbers of at most {FARTHEST_M:g} m, not {position.tolist()}")
    length = float(np.linalg.norm(quaternion))
    if not math.isfinite(length) or abs(length - 1) > 1e-2:
        raise FieldError(f"{field}.quat", f"must be a unit quaternion, not {quaternion.tolist()}")
    return make_pose(position, quaternion / length)


def pair_trajectory(message: Any, start_us: int, end_us: int, field: str) -> Trajectory:
    """Return the trajectory of a pair of poses at the start and the end of a frame; of the start alone where a frame takes no
    time. Raises `FieldError`."""
    for name in ("start_pose", "end_pose"):
        if not message.HasField(name):
            raise FieldError(f"{field}.{name}", "is missing")
    poses = np.stack([pose_of(getattr(message, name), f"{field}.{name}") for name in ("start_pose", "end_pose")])
    times = np.array([start_us, end_us]) / 1e6
    return Trajectory.from_poses(times, poses) if end_us > start_us else Trajectory.from_poses(times[:1], poses[:1])
