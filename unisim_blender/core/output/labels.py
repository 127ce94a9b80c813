"""The edited scene's boxes at one frame, in the world's, the ego vehicle's and every sensor's frame."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..geometry import FloatArray, Trajectory, invert_pose, quaternion_from_matrix
from ..world.drive import Actor, Camera, Drive, Lidar

VELOCITY_STEP_S = 0.05


def frame_labels(drive: Drive, frame: int) -> dict[str, Any]:
    """Boxes of all actors present at the frame's time and of static copies, as a JSON object. An ego body is labelled only where
    a sensor sees it.

    A sensor's boxes are where the actors are at that sensor's own timestamp of the frame. Poses are position (m) and quaternion
    wxyz of the box's centre, x forward, y left, z up; cameras use OpenCV's axes. Velocities are in the world frame, m/s.
    """
    time = drive.time_s[frame]
    ego = drive.world_from_ego.at(time)
    sensors: list[tuple[Camera | Lidar, Trajectory]] = [
        *((camera, camera.world_from_camera) for camera in drive.cameras.values()),
        *((lidar, lidar.world_from_lidar) for lidar in drive.lidars.values()),
    ]
    present = [actor for actor in drive.labelled_actors if actor.present(time)]
    return {
        "frame": frame,
        "time_s": time,
        "world_origin": np.asarray(drive.world_origin).tolist(),
        "world_from_ego": _pose(ego),
        "boxes": [_box(actor, time, ego) for actor in present],
        "static_copies": [
            {"id": copy.uid, "size_m": np.asarray(copy.source.size_m).tolist(), "world": _pose(copy.world_from_target)}
            for copy in drive.static_copies
        ],
        "sensors": {
            sensor.sensor_id: _sensor(drive, sensor, sensor.time_s[frame], pose.at(sensor.time_s[frame]))
            for sensor, pose in sensors
            if frame in sensor.time_s
        },
    }


def velocity(actor: Actor, time_s: float) -> FloatArray:
    """World velocity (3,) in m/s, by a central difference that stays within the actor's presence."""
    start, end = max(time_s - VELOCITY_STEP_S, actor.start_s), min(time_s + VELOCITY_STEP_S, actor.end_s)
    if end <= start:
        return np.zeros(3)
    positions = actor.world_from_actor.at(np.array([start, end]))[:, :3, 3]
    return np.asarray((positions[1] - positions[0]) / (end - start))


def _pose(pose: FloatArray) -> dict[str, list[float]]:
    return {"position": pose[:3, 3].tolist(), "quaternion_wxyz": quaternion_from_matrix(pose[:3, :3]).tolist()}


def _box(actor: Actor, time_s: float, world_from_ego: FloatArray) -> dict[str, Any]:
    pose = actor.world_from_actor.at(time_s)
    return {
        "id": actor.uid,
        "class": actor.label,
        "size_m": np.asarray(actor.size_m).tolist(),
        "is_moving": actor.is_moving,
        "inserted": actor.inserted,
        "velocity_m_s": velocity(actor, time_s).tolist(),
        "world": _pose(pose),
        "ego": _pose(invert_pose(world_from_ego) @ pose),
    }


def _sensor(drive: Drive, sensor: Camera | Lidar, time_s: float, world_from_sensor: FloatArray) -> dict[str, Any]:
    sensor_from_world = invert_pose(world_from_sensor)
    return {
        "time_s": time_s,
        "world_from_sensor": _pose(world_from_sensor),
        "boxes": {
            actor.uid: _pose(sensor_from_world @ actor.world_from_actor.at(time_s))
            for actor in drive.actors.values()
            if actor.present(time_s) and actor.visible_to(sensor)
        },
    }
