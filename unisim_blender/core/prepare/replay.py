"""A log's drive as a scene trained on it replays it: refined tracklets and sensor poses, all of the log's frames and sensors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..data.fingerprint import aligned
from ..data.log import REFINED, Log, extras_of
from ..data.moved import on_trajectory
from ..errors import SceneError
from ..geometry import FloatArray, Trajectory, invert_pose
from ..model.scene_file import SceneHeader
from ..world.drive import Actor, Camera, Drive, Lidar

ORIGIN_TOLERANCE_M = 1e-6
MAX_REFINEMENT_M = 1.0
"""Refinement moves poses by centimetres; another drive is metres away."""
MAX_DRIFT_M = 10.0
"""Largest difference, metres, between a log's poses and refined ones of the same drive."""
KEY_TOLERANCE_S = 1e-4


def aligned_log(header: SceneHeader, log: Log) -> Log:
    """Return a log in the world and time of a scene that was trained on its drive; the log itself where they are its own.

    A copy of the scene's log, a part of it and a conversion to another layout are of its drive. The log of a scene that
    was trained on refined poses gets the scene's trajectory of the ego. The ego's motion and some
    images and sweeps are compared (`data.fingerprint`); of a scene that keeps no fingerprint, the ego's positions in the
    log's own coordinates. Raises `SceneError` where the scene was trained on another drive.
    """
    if header.fingerprint is not None:
        place = f"{header.path}: was trained on"
        if header.training.get("poses") != REFINED or extras_of(log).poses == REFINED:
            return aligned(header.fingerprint, log, header.world_origin, place)
        log = aligned(header.fingerprint, log, header.world_origin, place, MAX_DRIFT_M)
        return on_trajectory(log, header.drive.world_from_ego, REFINED)
    drive = log.drive
    shared = [frame for frame in header.drive.frames if frame in drive.time_s]
    apart = np.linalg.norm(_ego_in_log_world(header.drive, shared) - _ego_in_log_world(drive, shared), axis=1)
    if not shared or apart.max() > MAX_REFINEMENT_M:
        by = f", whose vehicle is {apart.max():.1f} m away at frame {shared[int(apart.argmax())]}" if shared else ""
        raise SceneError(f"{header.path}: was trained on another drive than {log.path}{by}")
    if np.abs(header.drive.world_origin - drive.world_origin).max() > ORIGIN_TOLERANCE_M:
        own, logs = header.drive.world_origin.tolist(), drive.world_origin.tolist()
        raise SceneError(f"{header.path}: has its origin at {own}, {log.path} at {logs}")
    return log


def replayed_drive(header: SceneHeader, log: Log) -> Drive:
    """Return the scene's drive, and from a log that is aligned with it the frames and sensors that the scene lacks.

    Where the log goes on before or after that of the scene, trajectories do, too: displaced as their last key is, if
    training has corrected it.
    """
    own, drive = header.drive, log.drive
    whole = replace(
        own,
        frames=drive.frames,
        time_s=drive.time_s,
        cameras={**drive.cameras, **own.cameras},
        lidars={**drive.lidars, **own.lidars},
    )
    if set(drive.frames) <= set(own.frames):
        return whole
    sensors = drive.sensors
    return replace(
        whole.with_sensors(lambda sensor: _sensor(sensor, sensors.get(sensor.sensor_id, sensor))),
        world_from_ego=_extended(own.world_from_ego, drive.world_from_ego),
        actors={uid: _actor(actor, drive.actors.get(uid, actor)) for uid, actor in own.actors.items()},
    )


def _sensor(own: Camera | Lidar, logs: Camera | Lidar) -> Camera | Lidar:
    times = {**logs.time_s, **own.time_s}
    in_order = dict(sorted(times.items(), key=lambda entry: entry[1]))
    return replace(own.along(_extended(own.trajectory, logs.trajectory)), time_s=in_order)


def _actor(own: Actor, logs: Actor) -> Actor:
    own = replace(own, start_s=min(own.start_s, logs.start_s), end_s=max(own.end_s, logs.end_s))
    if len(own.world_from_actor.times_s) == 1:
        return own
    return replace(own, world_from_actor=_extended(own.world_from_actor, logs.world_from_actor))


def _extended(own: Trajectory, logs: Trajectory) -> Trajectory:
    """Return a scene's trajectory with the log's keys before its first and after its last, displaced as those are."""
    parts = []
    for side, end in (
        (logs.times_s < own.times_s[0] - KEY_TOLERANCE_S, 0),
        (logs.times_s > own.times_s[-1] + KEY_TOLERANCE_S, -1),
    ):
        correction = invert_pose(logs.at(own.times_s[end])) @ own.poses[end]
        parts.append((logs.times_s[side], logs.poses[side] @ correction))
    if not len(parts[0][0]) and not len(parts[1][0]):
        return own
    (times_before, before), (times_after, after) = parts
    times = np.concatenate([times_before, own.times_s, times_after])
    return Trajectory.from_poses(times, np.concatenate([before, own.poses, after]))


def _ego_in_log_world(drive: Drive, frames: list[int]) -> FloatArray:
    """Positions (F, 3) of the vehicle at frames, in the log's own coordinates."""
    times = np.array([drive.time_s[frame] for frame in frames])
    return np.asarray(drive.world_from_ego.at(times)[:, :3, 3] + drive.world_origin)
