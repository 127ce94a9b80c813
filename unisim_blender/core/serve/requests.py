"""Requests as what is to be rendered: one sensor in a drive of its own, in which everything is where the request has it.

Actors that stand still belong to the scene. One that moves is there if the request has it. Every fault names its field.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..errors import short
from ..formats.alpasim.messages import FieldError, model_of, pair_trajectory, sensorsim
from ..geometry import Trajectory, invert_pose
from ..world.captures import MAX_TIME_US, US_PER_SECOND, Capture
from ..world.drive import Actor, Camera, Drive, Lidar, LidarModel
from .scenes import ServedScene

LONGEST_US = 10 * US_PER_SECOND
"""Longest duration of a frame."""
MOST_OBJECTS = 2000
MARGIN_S = 1.0
"""Seconds before and after a frame for which a request's actors are there: shutters read a little beyond an image."""
FORMATS = ("PNG", "JPEG", "RGB_UINT8_PLANAR")
BEST = 95.0
"""The quality of JPEG files where the request has none, of 100."""


@dataclass(frozen=True, eq=False)
class ImageRequest:
    """An image to render: ``capture`` of the one camera of ``drive``, as a file of ``format`` and ``quality``."""

    scene: ServedScene
    drive: Drive
    capture: Capture
    format: str
    quality: float


@dataclass(frozen=True, eq=False)
class SweepRequest:
    """A sweep to render: ``capture`` of the one LiDAR of ``drive``."""

    scene: ServedScene
    drive: Drive
    capture: Capture


def image_request(scene: ServedScene, message: Any, at: str = "") -> ImageRequest:
    """Return what an `RGBRenderRequest` asks for; ``at`` goes before the names of its fields. Raises `FieldError`."""
    start_us, end_us = _frame(message, at)
    if message.insert_ego_mask:
        raise FieldError(f"{at}insert_ego_mask", "there are no masks of the ego vehicle")
    if not message.HasField("camera_intrinsics"):
        raise FieldError(f"{at}camera_intrinsics", "is missing")
    spec = message.camera_intrinsics
    recorded = scene.drive.cameras.get(spec.logical_id)
    if recorded is None:
        raise FieldError(
            f"{at}camera_intrinsics.logical_id",
            f"{short(spec.logical_id)} is not one of {', '.join(scene.drive.cameras) or 'none'}",
        )
    width, height = message.resolution_w, message.resolution_h
    model, time_us = model_of(spec, width, height, start_us, end_us, f"{at}camera_intrinsics")
    path = pair_trajectory(message.sensor_pose, start_us, end_us, f"{at}sensor_pose")
    camera = replace(recorded, model=model, world_from_camera=path, time_s={}, readouts=None)
    camera = replace(camera, full_width=recorded.full_width or recorded.model.width)
    names = {value: name for name, value in sensorsim.ImageFormat.items()}
    kind = names.get(message.image_format, str(message.image_format))
    if kind not in FORMATS:
        unset = " (a request that leaves it out)" if message.image_format == 0 else ""
        raise FieldError(f"{at}image_format", f"{kind}{unset} is not one of {', '.join(FORMATS)}")
    quality = message.image_quality or BEST
    if not 1 <= quality <= 100:
        raise FieldError(f"{at}image_quality", f"must lie from 1 to 100, not {quality:g}")
    drive = _drive(scene, camera, path, message, (start_us, end_us), at)
    return ImageRequest(scene, drive, Capture(camera.sensor_id, time_us), kind, quality)


def sweep_request(scene: ServedScene, message: Any, at: str = "") -> SweepRequest:
    """Return what a `LidarRenderRequest` asks for; ``at`` as of `image_request`. Raises `FieldError`.

    Without ``lidar_config``, the scene's first LiDAR is meant, else the one that has the device's name in small letters. The
    sweep ends with the frame.
    """
    start_us, end_us = _frame(message, at)
    lidars = scene.drive.lidars
    if not lidars:
        raise FieldError(f"{at}scene_id", f"{short(scene.scene_id)} has no LiDAR")
    if message.HasField("lidar_config"):
        kinds = {value: name for name, value in sensorsim.LidarDeviceType.items()}
        device = kinds.get(message.lidar_config.lidar_type, str(message.lidar_config.lidar_type))
        name = device.lower()
        if name not in lidars:
            raise FieldError(
                f"{at}lidar_config.lidar_type",
                f"{device}: the scene has no LiDAR {short(name)}; without lidar_config, {short(next(iter(lidars)))} is rendered",
            )
    else:
        name = next(iter(lidars))
    path = pair_trajectory(message.sensor_pose, start_us, end_us, f"{at}sensor_pose")
    recorded = lidars[name]
    model = _during(recorded.model, (end_us - start_us) / US_PER_SECOND)
    lidar = replace(recorded, model=model, world_from_lidar=path, time_s={}, phase=None)
    drive = _drive(scene, lidar, path, message, (start_us, end_us), at)
    return SweepRequest(scene, drive, Capture(name, end_us))


def _frame(message: Any, at: str) -> tuple[int, int]:
    start_us, end_us = message.frame_start_us, message.frame_end_us
    if start_us > MAX_TIME_US:
        raise FieldError(f"{at}frame_start_us", f"must be at most {MAX_TIME_US}, not {start_us}")
    if not start_us <= end_us <= start_us + LONGEST_US:
        raise FieldError(
            f"{at}frame_end_us", f"must lie from 0 to {LONGEST_US} us after the start, {start_us}, not at {end_us}"
        )
    return start_us, end_us


def _during(model: LidarModel, seconds: float) -> LidarModel:
    """Return a beam table whose sweep takes so long and ends at its time; where it takes no time, it is as it was recorded."""
    if seconds == 0:
        return model
    columns = model.column_time_s
    if columns is not None:
        columns = (columns - np.max(columns)) * (seconds / max(float(np.ptp(columns)), 1e-9))
    return replace(model, sweep_s=seconds, time_offset_s=0.0, column_time_s=columns)


def _drive(
    scene: ServedScene, sensor: Camera | Lidar, path: Trajectory, message: Any, frame_us: tuple[int, int], at: str
) -> Drive:
    """Return the drive of one frame: the vehicle is where its sensor is."""
    recorded = scene.drive
    ego_from_world = invert_pose(recorded.world_from_ego.at(0.0))
    mounted = recorded.sensors[sensor.sensor_id]
    ego = path.transformed(right=invert_pose(ego_from_world @ mounted.trajectory.at(0.0)))
    return replace(
        recorded,
        actors=_actors(scene, message.dynamic_objects, frame_us, f"{at}dynamic_objects"),
        world_from_ego=ego,
        cameras={sensor.sensor_id: sensor} if isinstance(sensor, Camera) else {},
        lidars={sensor.sensor_id: sensor} if isinstance(sensor, Lidar) else {},
    )


def _actors(scene: ServedScene, objects: Any, frame_us: tuple[int, int], field: str) -> dict[str, Actor]:
    known = scene.drive.actors
    actors = {uid: actor for uid, actor in known.items() if not actor.is_moving or actor.is_ego_body}
    if len(objects) > MOST_OBJECTS:
        raise FieldError(field, f"must be at most {MOST_OBJECTS}, not {len(objects)}")
    start_us, end_us = frame_us
    seen = set()
    for number, request in enumerate(objects):
        uid, name = request.track_id, f"{field}[{number}]"
        if uid not in known or known[uid].is_ego_body:
            raise FieldError(f"{name}.track_id", f"the scene has no actor {short(uid)}")
        if uid in seen:
            raise FieldError(f"{name}.track_id", f"{short(uid)} is there twice")
        seen.add(uid)
        track = pair_trajectory(request.pose_pair, start_us, end_us, f"{name}.pose_pair")
        start_s, end_s = start_us / US_PER_SECOND - MARGIN_S, end_us / US_PER_SECOND + MARGIN_S
        actors[uid] = replace(known[uid], world_from_actor=track, start_s=start_s, end_s=end_s, is_moving=True)
    return actors
