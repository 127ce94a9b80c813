"""Sensors on the vehicle: when they look at a frame, where they are mounted, and beam tables as objects carry them."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from ...core.geometry import FloatArray, invert_pose
from ...core.world.drive import Camera, Drive, Lidar, LidarModel
from ...core.world.drive_json import lidar_model_to_json
from ..sampled.clock import Clock


def recorded_mount(sensor: Camera | Lidar, drive: Drive, clock: Clock) -> FloatArray:
    """Poses (N, 4, 4) of a recorded sensor on the vehicle, core's axes: the vehicle at a frame's time, the
    sensor at its own."""
    trajectory = sensor.world_from_camera if isinstance(sensor, Camera) else sensor.world_from_lidar
    return np.asarray(
        invert_pose(drive.world_from_ego.at(clock.times_s)) @ trajectory.at(clock.of_sensor(sensor).times_s)
    )


def lag(sensor: Camera | Lidar | None, drive: Drive, clock: Clock) -> FloatArray:
    """How the recorded vehicle moves from a sensor's own times to the frames' (N, 4, 4); nothing for a sensor
    without own times.

    Objects stand at frames, so a sensor's object is off its mount by this much.
    """
    if sensor is None:
        return np.tile(np.eye(4), (len(clock.frames), 1, 1))
    then = drive.world_from_ego.at(clock.of_sensor(sensor).times_s)
    return np.asarray(invert_pose(then) @ drive.world_from_ego.at(clock.times_s))


def lidar_json(model: LidarModel) -> str:
    """A beam table as an object carries it."""
    return json.dumps(lidar_model_to_json(model))


def lidar_model(text: str) -> LidarModel:
    """The beam table that an object carries."""
    values: dict[str, Any] = json.loads(text)
    values |= {key: np.array(value, float) for key, value in values.items() if isinstance(value, list)}
    return LidarModel(**values)
