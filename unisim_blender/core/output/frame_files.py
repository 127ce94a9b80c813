"""The files of captures: images, sweeps and labels. Equal captures give equal bytes."""

from __future__ import annotations

import io
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from plyfile import PlyData, PlyElement

from ..colour import bytes_from_srgb
from ..files import write_file
from ..formats.rendered import camera_path, labels_path, lidar_path
from ..geometry import invert_pose, transform_points
from ..json_file import json_bytes
from ..sensors.frames import CameraFrame, LidarFrame
from ..sensors.lidar import column_azimuths
from ..world.captures import Capture, Moment
from ..world.drive import Drive
from .exr import camera_metadata, write_exr
from .labels import moment_labels

FORMATS = ("png", "exr", "ply", "npz", "labels")
"""What is written of a frame where nothing else is asked for."""

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
    """The content of a moment's labels."""
    return json_bytes(moment_labels(drive, moment))


def sweep_points(sweep: LidarFrame) -> NDArray[np.void]:
    """The returned cells, beam by beam, as records (N,) of `POINT_FIELDS`."""
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
    """An image (H, W, 3) or (H, W) as PNG."""
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()


def ply_bytes(points: NDArray[np.void], capture: Capture, time_s: float) -> bytes:
    """Records of `POINT_FIELDS` as binary PLY."""
    buffer = io.BytesIO()
    which = f"time_us {capture.time_us}" if capture.frame is None else f"frame {capture.frame}"
    comments = [f"sensor {capture.sensor_id}", which, f"time_s {time_s!r}", "frame of reference: the sensor at time_s"]
    PlyData([PlyElement.describe(points, "vertex")], byte_order="<", comments=comments).write(buffer)
    return buffer.getvalue()


def npz_bytes(points: NDArray[np.void], time_s: float, sweep: LidarFrame) -> bytes:
    """One array a field, and beside them world_from_lidar (4, 4) float64, time_s and the instances' names."""
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
