"""The edited scene's boxes at one moment, in the world's, the ego vehicle's and every sensor's frame."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from ..geometry import FloatArray, Trajectory, invert_pose, quaternion_from_matrix
from ..world.captures import Capture, Moment
from ..world.drive import Actor, Camera, Drive, Lidar
from ..world.replay import over_whole_frames, with_windows

VELOCITY_STEP_S = 0.05


def moment_labels(drive: Drive, moment: Moment) -> dict[str, Any]:
    """Boxes of all actors present at a moment and of static copies, as a JSON object. An ego body is labelled only
    where a sensor sees it.

    A frame of the log has every sensor of the drive, at that sensor's own timestamp of the frame; a time has those that
    are captured. A sensor's boxes are where the actors are at its timestamp. Poses are position (m) and quaternion wxyz
    of the box's centre, x forward, y left, z up; cameras use OpenCV's axes. Velocities are in the world frame, m/s.
    """
    time, frame = moment.time_s(drive), moment.frame
    ego = drive.world_from_ego.at(time)
    # shortly before the first frame and after the last one, where sensors of these look, actors are there, as images show
    if frame is None:
        drive = replace(drive, actors={actor.uid: actor for actor in with_windows(drive, drive.actors.values())})
    else:
        drive = over_whole_frames(drive)
    present = [actor for actor in drive.labelled_actors if actor.present(time)]
    return {
        **({"time_us": moment.time_us} if frame is None else {"frame": frame}),
        "time_s": time,
        "world_origin": np.asarray(drive.world_origin).tolist(),
        "world_from_ego": _pose(ego),
        "boxes": [_box(actor, time, ego) for actor in present],
        "static_copies": [
            {"id": copy.uid, "size_m": np.asarray(copy.source.size_m).tolist(), "world": _pose(copy.world_from_target)}
            for copy in drive.static_copies
        ],
        "sensors": {
            sensor.sensor_id: _sensor(drive, sensor, at, trajectory.at(at))
            for sensor, trajectory, at in _sensors(drive, moment)
        },
    }


def labels_digest(drive: Drive, moment: Moment) -> str:
    """Return a digest of what a moment's labels depend on, 64 hexadecimal digits; it takes a tenth of the time of the labels.
    Equal digests have equal labels, wherever scenes and meshes lie."""
    time, frame = moment.time_s(drive), moment.frame
    actors = list(over_whole_frames(drive).actors.values())
    if frame is None:
        actors = with_windows(drive, actors)
    seen = list(_sensors(drive, moment))
    times = [time, *(at for _, _, at in seen)]
    start_s, end_s = min(times) - VELOCITY_STEP_S, max(times) + VELOCITY_STEP_S
    every: list[Camera | Lidar] = [*drive.cameras.values(), *drive.lidars.values()]
    bodies = any(one.sees_ego_body for one in every)
    sensors = [[one.sensor_id, at, one.sees_ego_body] for one, _, at in seen]
    digest = hashlib.sha256(json.dumps([moment.time_us, frame, time, sensors, bodies]).encode())
    digest.update(np.asarray(drive.world_origin, np.float64).tobytes())
    tracks = (trajectory for _, trajectory, _ in seen)
    for track in (drive.world_from_ego, *tracks):
        digest.update(track.between(start_s, end_s).content())
    for actor in actors:
        if not any(actor.start_s <= at <= actor.end_s for at in times):
            continue
        words = (actor.uid, actor.label, actor.is_moving, actor.inserted, actor.is_ego_body)
        presence = max(actor.start_s, start_s), min(actor.end_s, end_s)
        digest.update(json.dumps(words).encode() + np.array([*actor.size_m, *presence]).tobytes())
        digest.update(actor.world_from_actor.between(start_s, end_s).content())
    for copy in drive.static_copies:
        digest.update(json.dumps(copy.uid).encode() + np.asarray(copy.source.size_m, np.float64).tobytes())
        digest.update(np.asarray(copy.world_from_target, np.float64).tobytes())
    return digest.hexdigest()


def _sensors(drive: Drive, moment: Moment) -> Iterator[tuple[Camera | Lidar, Trajectory, float]]:
    """Yield the sensors that labels have, their trajectories, and when they look."""
    frame = moment.frame
    cameras = {one.sensor_id: one for one in moment.cameras}
    lidars = {one.sensor_id: one for one in moment.lidars}
    if frame is not None:
        cameras = {name: Capture.of_frame(one, frame) for name, one in drive.cameras.items() if frame in one.time_s}
        lidars = {name: Capture.of_frame(one, frame) for name, one in drive.lidars.items() if frame in one.time_s}
    for name, capture in cameras.items():
        yield drive.cameras[name], drive.cameras[name].world_from_camera, capture.time_s(drive.cameras[name])
    for name, capture in lidars.items():
        yield drive.lidars[name], drive.lidars[name].world_from_lidar, capture.time_s(drive.lidars[name])


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
