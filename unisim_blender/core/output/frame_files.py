"""The files of captures: images, sweeps and labels. Equal captures give equal bytes.

Channels: R G B (linear Rec.709, half) and A, 1 everywhere: the background is part of the image, so it is opaque and its
colour premultiplied; depth, z_depth (m, float; inf where nothing was hit), normal.X .Y .Z (world frame, half), instance
(float, whole numbers: programs scale integer channels to 0..1 where they read all channels as float; 0 is the
background, n the n-th name of the header's instances), opacity (half; of all that is nearer than the background) and
unsupported (half; 1 where no recorded ray supports the pixel), confidence (half). A pass that was not rendered has no channel.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Collection, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
from numpy.typing import NDArray
from PIL import Image
from plyfile import PlyData, PlyElement

from ..colour import bytes_from_srgb, linear_from_srgb
from ..files import partial_file, write_file
from ..formats.rendered import camera_path, labels_path, lidar_path
from ..geometry import FloatArray, invert_pose, quaternion_from_matrix, transform_points
from ..json_file import json_bytes
from ..scenario.types import FRAME_FORMATS as FORMATS
from ..sensors.frames import CameraFrame, LidarFrame
from ..sensors.lidar import column_azimuths
from ..world.captures import Capture, Moment
from ..world.drive import Actor, Camera, Drive, Lidar
from ..world.replay import over_whole_frames, with_windows

REC709_CHROMATICITIES = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)
METADATA_ATTRIBUTE = "unisim"
"""Header attribute with a JSON object: OpenEXR keeps single numbers as float32, and a time needs more."""


def exr_channels(frame: CameraFrame) -> dict[str, NDArray[Any]]:
    """Return the frame's passes as arrays (H, W) by channel name."""
    linear = linear_from_srgb(np.clip(frame.rgb, 0, 1))
    channels: dict[str, NDArray[Any]] = {name: linear[..., i].astype(np.float16) for i, name in enumerate("RGB")}
    channels["A"] = np.ones(frame.rgb.shape[:2], np.float16)
    if frame.depth_m is not None:
        channels["depth"] = frame.depth_m.astype(np.float32)
    if frame.z_depth_m is not None:
        channels["z_depth"] = frame.z_depth_m.astype(np.float32)
    if frame.normal is not None:
        channels |= {f"normal.{axis}": frame.normal[..., i].astype(np.float16) for i, axis in enumerate("XYZ")}
    if frame.instance is not None:
        channels["instance"] = frame.instance.astype(np.float32)
    if frame.opacity is not None:
        channels["opacity"] = frame.opacity.astype(np.float16)
    if frame.unsupported is not None:
        channels["unsupported"] = frame.unsupported.astype(np.float16)
    if frame.confidence is not None:
        channels["confidence"] = frame.confidence.astype(np.float16)
    return {name: np.ascontiguousarray(values) for name, values in channels.items()}


def camera_metadata(frame: CameraFrame, capture: Capture, time_s: float) -> dict[str, Any]:
    """Return the metadata that a reader needs to use the image as a measurement; ``time_s`` is the image's timestamp.
    An image that is none of the log's has ``time_us`` in place of ``frame``."""
    model = frame.model
    return {
        "sensor": capture.sensor_id,
        **({"time_us": capture.time_us} if capture.frame is None else {"frame": capture.frame}),
        "time_s": time_s,
        "width": model.width,
        "height": model.height,
        "K": [[model.fx, 0.0, model.cx], [0.0, model.fy, model.cy], [0.0, 0.0, 1.0]],
        "world_from_camera": frame.world_from_camera.tolist(),
        "camera_axes": "x right, y down, z forward",
        "shutter": model.shutter.to_dict(),
        **({} if model.is_pinhole else {"lens": model.lens.to_dict()}),
        "instances": list(frame.instances),
    }


def write_exr(path: Path, frame: CameraFrame, metadata: dict[str, Any]) -> None:
    """Write the frame with ``metadata`` (`camera_metadata`) in its header. Raises `OutputError`."""
    header = {
        "compression": OpenEXR.ZIP_COMPRESSION,
        "type": OpenEXR.scanlineimage,
        "chromaticities": REC709_CHROMATICITIES,
        "K": np.array(metadata["K"], np.float64),
        "world_from_camera": np.array(metadata["world_from_camera"], np.float64),
        METADATA_ATTRIBUTE: json.dumps(metadata),
    }
    with partial_file(path) as temporary:
        OpenEXR.File(header, exr_channels(frame)).write(str(temporary))


POINT_FIELDS = np.dtype(
    [
        ("x", "<f4"),
        ("y", "<f4"),
        ("z", "<f4"),
        ("intensity", "<f4"),
        ("ring", "<i4"),
        ("azimuth", "<f4"),
        ("time", "<f8"),
        ("instance", "<i4"),
    ]
)
"""x y z (m) in the LiDAR's frame at the frame's time, intensity 0..1, ring (beam), azimuth of firing (rad, in the
sensor's frame at the ray's own time), time (s, from the log's first frame), instance (0: background, n: the n-th name
of ``instances``)."""


def write_camera(
    out: Path, name: str, capture: Capture, time_s: float, image: CameraFrame, formats: Collection[str] = FORMATS
) -> list[Path]:
    """Write PNG (sRGB as it is) and EXR (linear, all passes), where asked for; the files' paths.
    Raises `OutputError`."""
    paths = []
    if "png" in formats:
        paths.append(camera_path(out, capture.sensor_id, name, ".png"))
        write_file(paths[-1], png_bytes(bytes_from_srgb(image.rgb)))
    if "exr" in formats:
        paths.append(camera_path(out, capture.sensor_id, name, ".exr"))
        write_exr(paths[-1], image, camera_metadata(image, capture, time_s))
    return paths


def write_lidar(
    out: Path, name: str, capture: Capture, time_s: float, sweep: LidarFrame, formats: Collection[str] = FORMATS
) -> list[Path]:
    """Write the sweep's returns as PLY and NPZ, where asked for; the files' paths. Raises `OutputError`."""
    points, paths = sweep_points(sweep), []
    if "ply" in formats:
        paths.append(lidar_path(out, capture.sensor_id, name, ".ply"))
        write_file(paths[-1], ply_bytes(points, capture, time_s))
    if "npz" in formats:
        paths.append(lidar_path(out, capture.sensor_id, name, ".npz"))
        write_file(paths[-1], npz_bytes(points, time_s, sweep))
    return paths


def write_labels(out: Path, drive: Drive, moment: Moment) -> list[Path]:
    """Write the edited scene's boxes; the file's path. Raises `OutputError`."""
    path = labels_path(out, moment.name)
    write_file(path, labels_bytes(drive, moment))
    return [path]


def labels_bytes(drive: Drive, moment: Moment) -> bytes:
    """Return the content of a moment's labels."""
    return json_bytes(moment_labels(drive, moment))


def sweep_points(sweep: LidarFrame) -> NDArray[np.void]:
    """Return the cells with a return, beam by beam, as records (N,) of `POINT_FIELDS`."""
    ring, column = np.nonzero(sweep.returned)
    world = sweep.origins[ring, column] + sweep.directions[ring, column] * sweep.depth_m[ring, column, None].astype(
        np.float64
    )
    points = np.zeros(len(ring), POINT_FIELDS)
    local = transform_points(invert_pose(sweep.world_from_lidar), world)
    points["x"], points["y"], points["z"] = local.T
    points["intensity"] = sweep.intensity[ring, column]
    points["ring"] = ring
    model = sweep.model
    azimuth = column_azimuths(model)[column]
    points["azimuth"] = np.mod(azimuth + model.azimuth_offset_rad[ring] + np.pi, 2 * np.pi) - np.pi
    points["time"] = sweep.time_s[ring, column]
    points["instance"] = sweep.instance[ring, column]
    return points


def png_bytes(image: NDArray[np.uint8]) -> bytes:
    """Return an image (H, W, 3) or (H, W) uint8 as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()


def ply_bytes(points: NDArray[np.void], capture: Capture, time_s: float) -> bytes:
    """Return records (N,) of `POINT_FIELDS` as binary PLY."""
    buffer = io.BytesIO()
    which = f"time_us {capture.time_us}" if capture.frame is None else f"frame {capture.frame}"
    comments = [f"sensor {capture.sensor_id}", which, f"time_s {time_s!r}", "frame of reference: the sensor at time_s"]
    PlyData([PlyElement.describe(points, "vertex")], byte_order="<", comments=comments).write(buffer)
    return buffer.getvalue()


def npz_bytes(points: NDArray[np.void], time_s: float, sweep: LidarFrame) -> bytes:
    """Return an NPZ of one array (N,) a field, world_from_lidar (4, 4) float64, time_s and the instances' names."""
    buffer = io.BytesIO()
    # numpy gives every member of the archive the date 1980-01-01, so equal arrays are equal bytes
    np.savez_compressed(
        buffer,
        **{name: points[name] for name in POINT_FIELDS.names or ()},
        world_from_lidar=np.asarray(sweep.world_from_lidar, np.float64),
        time_s=np.float64(time_s),
        instances=np.array(sweep.instances, dtype=np.str_),
    )
    return buffer.getvalue()


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
        "sensors": {sensor.sensor_id: _sensor(drive, sensor, at) for sensor, at in _sensors(drive, moment)},
    }


def labels_digest(drive: Drive, moment: Moment) -> str:
    """Return a digest of the input of a moment's labels, 64 hexadecimal digits; it takes a tenth of the time of the
    labels. Equal digests have equal labels, wherever scenes and meshes lie."""
    time, frame = moment.time_s(drive), moment.frame
    actors = list(over_whole_frames(drive).actors.values())
    if frame is None:
        actors = with_windows(drive, actors)
    seen = list(_sensors(drive, moment))
    times = [time, *(at for _, at in seen)]
    start_s, end_s = min(times) - VELOCITY_STEP_S, max(times) + VELOCITY_STEP_S
    bodies = any(sensor.sees_ego_body for sensor in drive.sensors.values())
    sensors = [[sensor.sensor_id, at, sensor.sees_ego_body] for sensor, at in seen]
    digest = hashlib.sha256(json.dumps([moment.time_us, frame, time, sensors, bodies]).encode())
    digest.update(np.asarray(drive.world_origin, np.float64).tobytes())
    for track in (drive.world_from_ego, *(sensor.trajectory for sensor, _ in seen)):
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


def _sensors(drive: Drive, moment: Moment) -> Iterator[tuple[Camera | Lidar, float]]:
    """Yield the sensors that labels have, and when they look."""
    if moment.frame is not None:
        moment = Moment.of_frame(drive, moment.frame, drive.cameras, drive.lidars)
    sensors = drive.sensors
    for capture in moment.captures.values():
        yield sensors[capture.sensor_id], capture.time_s(sensors[capture.sensor_id])


def velocity(actor: Actor, time_s: float) -> FloatArray:
    """Return the velocity (3,), m/s, world frame, by a central difference that stays within the actor's presence."""
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


def _sensor(drive: Drive, sensor: Camera | Lidar, time_s: float) -> dict[str, Any]:
    world_from_sensor = sensor.trajectory.at(time_s)
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
