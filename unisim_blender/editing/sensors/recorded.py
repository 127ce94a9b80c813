"""Where the sensors of a drive were when they recorded, in Blender's axes."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray
from ...core.world.drive import Camera, Drive, Lidar
from ..sampled.clock import Clock
from ..sampled.poses import optical

NEAR_M, NEAR_RAD = 0.05, 0.005
"""Within these of where it was recorded a camera sees its recorded image."""


def recorded_pose(sensor: Camera | Lidar, drive: Drive, frame: float) -> FloatArray:
    """Return where a sensor was recorded at a frame (4, 4), Blender's axes."""
    at = Clock.of(drive).capture(sensor, frame).time_s(sensor)
    if isinstance(sensor, Camera):
        return optical(sensor.world_from_camera.at(at))
    return sensor.world_from_lidar.at(at)


def from_frame(drive: Drive, frame: float) -> Clock:
    """The clock that begins with ``frame``, whole or not."""
    frames = np.array([frame, frame + 1.0])
    return Clock(frames, Clock.of(drive).time_s(frames))


def recorded_camera_pose(drive: Drive, uid: str, frame: float) -> FloatArray:
    """Return where a camera of the drive was when it recorded a frame's image: (4, 4) in the world, Blender's axes.

    The newest answer for each camera is kept: every redraw asks for it, more than once.
    """
    kept = _poses.get(uid)
    if kept is None or kept[0] is not drive or kept[1] != frame:
        _poses[uid] = kept = drive, frame, recorded_pose(drive.cameras[uid], drive, frame)
    return kept[2]


_poses: dict[str, tuple[Drive, float, FloatArray]] = {}
"""By camera: the drive and the frame that were asked for last, and the pose."""


def sees_the_same(now: FloatArray, then: FloatArray) -> bool:
    """Return whether a camera's pose (4, 4) is, within `NEAR_M` and `NEAR_RAD`, the one from which its
    image was recorded."""
    turned = np.linalg.norm(now[:3, :3] - then[:3, :3]) / np.sqrt(2)
    return bool(np.linalg.norm(now[:3, 3] - then[:3, 3]) <= NEAR_M and turned <= NEAR_RAD)
