"""A long segment of Waymo Open: five cameras, as the layout has, and the top LiDAR at full size."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow
from pyarrow import parquet

from .pictures import picture
from .traffic import SIZE_M, SPEED_M_S, boxes_of

SEGMENT, START_US, TURN_US = "segment-1_0_0_0", 1_553_629_304_740_123, 100_000
ROWS, COLUMNS = 64, 2650
IMAGE, CAMERAS = (1920, 1280), 5
GROUP_BYTES = 64 * 2**20
FRAME, LASER, CAMERA = "key.frame_timestamp_micros", "key.laser_name", "key.camera_name"


def write(root: Path, frames: int) -> Path:
    """Write the segment, its files in groups of rows of some 64 MiB; gives the path that opens it."""
    stamps = [START_US + frame * TURN_US for frame in range(frames)]
    _put(root, "vehicle_pose", 1 << 20, (
        {FRAME: stamp, "[VehiclePoseComponent].world_from_vehicle.transform": _pose(frame * 0.1 + 0.05)}
        for frame, stamp in enumerate(stamps)
    ))  # fmt: skip
    _put(root, "camera_calibration", 1 << 20, map(_calibration, range(1, CAMERAS + 1)))
    image = picture("JPEG", IMAGE, 50)
    _put(root, "camera_image", GROUP_BYTES // len(image), (
        _image(image, frame, stamp, number) for frame, stamp in enumerate(stamps) for number in range(1, CAMERAS + 1)
    ))  # fmt: skip
    part = "[LiDARCalibrationComponent]."
    inclinations = np.radians(np.linspace(-17.6, 2.4, ROWS)).tolist()
    _put(root, "lidar_calibration", 1 << 20, iter([{
        LASER: np.int8(1), f"{part}extrinsic.transform": _pose(0.0, 2.1), f"{part}beam_inclination.values": inclinations,
        f"{part}beam_inclination.min": -0.31, f"{part}beam_inclination.max": 0.05,
    }]))  # fmt: skip
    returned = _ranges()
    _put(root, "lidar", GROUP_BYTES // (2 * returned.nbytes), (_sweep(returned, stamp) for stamp in stamps))
    _put(root, "lidar_pose", GROUP_BYTES // (returned.nbytes * 6 // 4), (
        {FRAME: stamp, LASER: np.int8(1), "[LiDARPoseComponent].range_image_return1.values": _pose_image(frame),
         "[LiDARPoseComponent].range_image_return1.shape": np.array([ROWS, COLUMNS, 6], np.int32)}
        for frame, stamp in enumerate(stamps)
    ))  # fmt: skip
    _put(root, "lidar_box", 1 << 20, (
        _box(box.uid, box.place_m, stamp) for frame, stamp in enumerate(stamps) for box in boxes_of(frame, frames)
    ))  # fmt: skip
    return root


def _put(root: Path, component: str, group: int, rows: Iterator[dict[str, Any]]) -> None:
    """Write rows in groups of so many."""
    path, writer = root / component / f"{SEGMENT}.parquet", None
    path.parent.mkdir(parents=True)
    some: list[dict[str, Any]] = []
    for row in rows:
        some.append(row)
        if len(some) == group:
            writer = _put_group(path, writer, some)
            some = []
    if some:
        writer = _put_group(path, writer, some)
    assert writer is not None
    writer.close()


def _put_group(path: Path, writer: Any, rows: list[dict[str, Any]]) -> Any:
    table = pyarrow.table({name: pyarrow.array([row[name] for row in rows]) for name in rows[0]})
    writer = writer or parquet.ParquetWriter(str(path), table.schema, compression="zstd")
    writer.write_table(table, row_group_size=len(rows))
    return writer


def _pose(time_s: float, up_m: float = 0.0) -> list[float]:
    matrix = np.eye(4)
    matrix[:3, 3] = time_s * SPEED_M_S, 0.0, up_m
    return [float(value) for value in matrix.ravel()]


def _calibration(number: int) -> dict[str, Any]:
    part, values = "[CameraCalibrationComponent].", (2050.0, 2050.0, 960.0, 640.0, 0.04, -0.33, 0.001, 0.0, 0.0)
    names = ("f_u", "f_v", "c_u", "c_v", "k1", "k2", "p1", "p2", "k3")
    return {
        CAMERA: np.int8(number), f"{part}extrinsic.transform": _pose(0.0, 2.1),
        **{f"{part}intrinsic.{name}": value for name, value in zip(names, values, strict=True)},
        f"{part}width": np.int32(IMAGE[0]), f"{part}height": np.int32(IMAGE[1]),
        f"{part}rolling_shutter_direction": np.int8(2),
    }  # fmt: skip


def _image(data: bytes, frame: int, stamp: int, number: int) -> dict[str, Any]:
    part, trigger = "[CameraImageComponent].", frame * 0.1 + 0.005 * number
    unix = START_US / 1e6 + trigger
    return {
        FRAME: stamp, CAMERA: np.int8(number), f"{part}image": data, f"{part}pose.transform": _pose(trigger + 0.025),
        f"{part}pose_timestamp": unix + 0.025, f"{part}rolling_shutter_params.shutter": 0.003,
        f"{part}rolling_shutter_params.camera_trigger_time": unix,
        f"{part}rolling_shutter_params.camera_readout_done_time": unix + 0.047,
    }  # fmt: skip


def _ranges() -> Any:
    """A range image (H, W, 4) of the ground, to centimetres; the beams above the horizon do not return."""
    rise = np.radians(np.linspace(2.4, -17.6, ROWS))[:, None]
    distance = 2.1 / np.sin(np.maximum(-rise, 1e-3)) * (1 + 0.02 * np.sin(np.arange(COLUMNS) / 9))
    image = np.full((ROWS, COLUMNS, 4), -1, np.float32)
    image[..., 0], image[..., 1] = np.where(distance < 75, distance.round(2), -1), 0.2
    return image


def _sweep(image: Any, stamp: int) -> dict[str, Any]:
    part, shape = "[LiDARComponent].range_image_return", np.array([ROWS, COLUMNS, 4], np.int32)
    return {
        FRAME: stamp, LASER: np.int8(1), f"{part}1.values": image.ravel(), f"{part}1.shape": shape,
        f"{part}2.values": np.full(image.size, -1, np.float32), f"{part}2.shape": shape,
    }  # fmt: skip


def _pose_image(frame: int) -> Any:
    image = np.zeros((ROWS, COLUMNS, 6), np.float32)
    image[..., 3] = (frame * 0.1 + 0.1 * (np.arange(COLUMNS) + 0.5) / COLUMNS) * SPEED_M_S
    return image.ravel()


def _box(uid: int, place: Any, stamp: int) -> dict[str, Any]:
    part = "[LiDARBoxComponent]."
    return {
        FRAME: stamp, "key.laser_object_id": f"{uid:08x}", f"{part}box.heading": 0.0, f"{part}type": np.int8(1),
        **{f"{part}box.center.{axis}": float(place[i]) for i, axis in enumerate("xyz")},
        **{f"{part}box.size.{axis}": SIZE_M[i] for i, axis in enumerate("xyz")},
    }  # fmt: skip
