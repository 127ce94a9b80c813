"""Sensors on the vehicle: when they look at a frame, where they are mounted, where they were when they recorded, and
their directions as yaw (to the left) and pitch (up) in radians; beam tables."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ...core.errors import UnisimError
from ...core.geometry import FloatArray, invert_pose
from ...core.world.drive import Camera, Drive, Lidar, LidarModel
from ...core.world.drive_json import arrays_to_json
from ..sampled.clock import Clock
from ..sampled.scene import optical


def recorded_mount(sensor: Camera | Lidar, drive: Drive, clock: Clock) -> FloatArray:
    """Poses (N, 4, 4) of a recorded sensor on the vehicle, core's axes: the vehicle at a frame's time, the
    sensor at its own."""
    own = sensor.trajectory.at(clock.of_sensor(sensor).times_s)
    return np.asarray(invert_pose(drive.world_from_ego.at(clock.times_s)) @ own)


def lag(sensor: Camera | Lidar | None, drive: Drive, clock: Clock) -> FloatArray:
    """Return the recorded vehicle's motion from a sensor's own times to the frames' (N, 4, 4); identities for a sensor
    without own times.

    Objects stand at frames, so a sensor's object is off its mount by this much.
    """
    if sensor is None:
        return np.tile(np.eye(4), (len(clock.frames), 1, 1))
    then = drive.world_from_ego.at(clock.of_sensor(sensor).times_s)
    return np.asarray(invert_pose(then) @ drive.world_from_ego.at(clock.times_s))


def lidar_json(model: LidarModel) -> str:
    """A beam table as an object carries it."""
    return json.dumps(arrays_to_json(model))


def lidar_model(text: str) -> LidarModel:
    """The beam table that an object carries."""
    values: dict[str, Any] = json.loads(text)
    values |= {key: np.array(value, float) for key, value in values.items() if isinstance(value, list)}
    return LidarModel(**values)


AHEAD = {"CAMERA": (0.0, 0.0, -1.0), "LIDAR": (1.0, 0.0, 0.0)}
"""Viewing directions of sensors in their objects' axes."""
STEEPEST_RAD = np.radians(89.0)


def angles(direction: FloatArray) -> tuple[float, float]:
    """Return yaw and pitch of a direction (3,) of any length."""
    unit = direction / np.linalg.norm(direction)
    return float(np.arctan2(unit[1], unit[0])), float(np.arcsin(np.clip(unit[2], -1, 1)))


def level_axes(yaw: float, pitch: float) -> FloatArray:
    """Axes (3, 3) that look along yaw and pitch without roll."""
    a, b, c, d = np.cos(yaw), np.sin(yaw), np.cos(pitch), np.sin(pitch)
    return np.array([[a, -b, 0], [b, a, 0], [0, 0, 1]]) @ np.array([[c, 0, -d], [0, 1, 0], [d, 0, c]])


def turned_to(axes: FloatArray, base: FloatArray, kind: str, yaw_rad: float, pitch_rad: float) -> FloatArray:
    """Return a sensor's axes (3, 3) turned until it looks along yaw and pitch in the axes ``base`` (3, 3) of the
    vehicle; its roll stays, and its pitch is at most `STEEPEST_RAD`. ``kind`` is CAMERA or LIDAR."""
    before = level_axes(*angles(base.T @ axes @ np.array(AHEAD[kind])))
    pitch_rad = float(np.clip(pitch_rad, -STEEPEST_RAD, STEEPEST_RAD))
    return np.asarray(base @ level_axes(yaw_rad, pitch_rad) @ before.T @ base.T @ axes)


NEAR_M, NEAR_RAD = 0.05, 0.005
"""Within these of where it was recorded a camera sees its recorded image."""


def recorded_pose(sensor: Camera | Lidar, drive: Drive, frame: float) -> FloatArray:
    """Return where a sensor was recorded at a frame (4, 4), Blender's axes."""
    pose = sensor.trajectory.at(Clock.of(drive).capture(sensor, frame).time_s(sensor))
    return optical(pose) if isinstance(sensor, Camera) else pose


def from_frame(drive: Drive, frame: float) -> Clock:
    """The clock that begins with ``frame``, whole or not."""
    frames = np.array([frame, frame + 1.0])
    return Clock(frames, Clock.of(drive).time_s(frames))


def recorded_camera_pose(drive: Drive, uid: str, frame: float) -> FloatArray:
    """Return where a camera of the drive was when it recorded a frame's image: (4, 4) in the world, Blender's axes.

    The newest answer for each camera is kept: every redraw asks for it, more than once.
    """
    cached = _poses.get(uid)
    if cached is None or cached[0] is not drive or cached[1] != frame:
        _poses[uid] = cached = drive, frame, recorded_pose(drive.cameras[uid], drive, frame)
    return cached[2]


_poses: dict[str, tuple[Drive, float, FloatArray]] = {}
"""By camera: the drive and the frame that were asked for last, and the pose."""


def sees_the_same(now: FloatArray, then: FloatArray) -> bool:
    """Return whether a camera's pose (4, 4) is, within `NEAR_M` and `NEAR_RAD`, the one from which its
    image was recorded."""
    turned = np.linalg.norm(now[:3, :3] - then[:3, :3]) / np.sqrt(2)
    return bool(np.linalg.norm(now[:3, 3] - then[:3, 3]) <= NEAR_M and turned <= NEAR_RAD)


def own_table(elevations: str, columns: int, max_range_m: float) -> LidarModel:
    """A LiDAR whose beams have these elevations, degrees separated by commas. Raises `UnisimError`."""
    try:
        degrees = np.array(sorted((float(part) for part in elevations.split(",") if part.strip()), reverse=True))
    except ValueError as fault:
        raise UnisimError(f'elevations "{elevations}": are not numbers separated by commas') from fault
    if not len(degrees) or not (np.abs(degrees) <= 90).all():
        raise UnisimError(f'elevations "{elevations}": must be at least one, between -90 and 90 degrees')
    return LidarModel(np.radians(degrees), np.zeros(len(degrees)), columns=columns, max_range_m=max_range_m)
