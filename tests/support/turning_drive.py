"""A drive on which nothing is simple: a turning ego, sensors with keys of their own, actors that turn,
stand and come late."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_matrix, quaternion_from_yaw
from unisim_blender.core.world.drive import (
    Actor,
    Appearance,
    Camera,
    CameraModel,
    Drive,
    Lidar,
    LidarModel,
    RollingShutter,
)

FRONT = quaternion_from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))
"""A camera's axes when it looks along x."""


def arc(times: FloatArray, start: tuple[float, float, float], speed: float, yaw_rate: float) -> Trajectory:
    """An actor that drives at ``speed`` and turns at ``yaw_rate``, with keys at times."""
    yaw = yaw_rate * times
    radius = speed / yaw_rate
    positions = np.array(start) + np.stack([radius * np.sin(yaw), radius * (1 - np.cos(yaw)), 0 * yaw], -1)
    return Trajectory(times, positions, quaternion_from_yaw(yaw))


def turning_drive() -> Drive:
    """Eleven frames at 10 Hz of an ego that turns left at 0.5 rad/s."""
    frames = tuple(range(11))
    time_s = {frame: 0.1 * frame for frame in frames}
    keys = np.array(list(time_s.values()))
    ego = arc(keys, (0, 0, 0), 8.0, 0.5)
    camera_times = keys - 0.05
    camera_mount = make_pose(np.array([1.5, 0.1, 1.6]), FRONT)
    camera = Camera(
        "front",
        CameraModel(64, 36, 60.0, 61.0, 32.5, 17.5, RollingShutter(0.03, 0.5)),
        Trajectory.from_poses(camera_times, ego.at(camera_times) @ camera_mount),
        dict(zip(frames, camera_times.tolist(), strict=True)),
    )
    lidar_keys = np.arange(-0.1, 1.05, 0.07)
    lidar = Lidar(
        "top",
        LidarModel(np.radians([5.0, 0.0, -5.0]), np.zeros(3), columns=36),
        Trajectory.from_poses(
            lidar_keys, ego.at(lidar_keys) @ make_pose(np.array([0.0, 0, 1.8]), quaternion_from_yaw(0.1))
        ),
        time_s,
        np.zeros((3, 36), bool),
    )
    actors = [
        Actor(
            "car",
            "Car",
            np.array([4.4, 1.9, 1.5]),
            arc(keys, (12, 1, 0.75), 5.0, 0.4),
            0.0,
            1.0,
            True,
            Appearance("car"),
        ),
        Actor(
            "late",
            "Car",
            np.array([4.0, 1.8, 1.4]),
            arc(keys[3:], (20, 4, 0.7), 9.0, -0.3),
            0.3,
            0.8,
            True,
            Appearance("late"),
        ),
        Actor(
            "van",
            "Van",
            np.array([6.0, 2.2, 2.5]),
            arc(keys[:1], (30, -4, 1.25), 1.0, 1.0),
            0.0,
            1.0,
            False,
            Appearance("van"),
        ),
    ]
    return Drive("turn", frames, time_s, ego, {"front": camera}, {"top": lidar}, {actor.uid: actor for actor in actors})
