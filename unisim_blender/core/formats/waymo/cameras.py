"""Waymo's cameras: distorted lenses, and shutters that read columns from the left.

The camera's frame is x forward, y left, z up; ours is OpenCV's. Pixel (0, 0) begins at the image's corner, as ours does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ...geometry import FloatArray
from ...lenses import PINHOLE
from ...lenses.lens import Lens, LensError
from ...lenses.opencv_pinhole import OpenCVPinhole
from ...world.drive import CameraModel, Readouts, RollingShutter
from ..common.arrow.columns import Kind
from .segment import CAMERA, FRAME, Segment, check_places

CALIBRATION, IMAGES = "camera_calibration", "camera_image"
NAMES = {1: "front", 2: "front_left", 3: "front_right", 4: "side_left", 5: "side_right"}
JPEG = "[CameraImageComponent].image"
VEHICLE_FROM_OPENCV = np.array([[0.0, 0, 1, 0], [-1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
"""OpenCV's axes in the camera's own."""
READ_OUT = {0: ("rows", False), 1: ("rows", False), 2: ("columns", False), 3: ("rows", True), 4: ("columns", True)}
"""Which lines a shutter reads and whether from the last: top to bottom, left to right, and their opposites. Number 5, and an
unknown direction (0), count as a global shutter."""
MAX_SIDE = 1 << 15
MOST_EXPOSURE_S = 0.2
SAME_S = 1e-6
"""Exposures that differ by less are equally long."""


@dataclass(frozen=True)
class WaymoCalibration:
    """A camera's model, without a shutter's times; its mount (4, 4), OpenCV's axes in the vehicle's; its read-out's number."""

    model: CameraModel
    mount: FloatArray
    read_out: int


@dataclass(frozen=True)
class ImageRows:
    """The rows of `IMAGES`: camera (N,) numbers, stamp_us (N,) of their frames, and in Unix seconds: when the vehicle was at
    pose (N, 4, 4), and the middles of exposure of the first and the last line to be read."""

    camera: NDArray[np.int64]
    stamp_us: NDArray[np.int64]
    pose: FloatArray
    pose_s: FloatArray
    first_s: FloatArray
    last_s: FloatArray


def read_calibrations(segment: Segment) -> dict[int, WaymoCalibration]:
    """Return the cameras by their numbers. Raises `LogError`."""
    part, path = "[CameraCalibrationComponent].", segment.file(CALIBRATION)
    pixels, bends = ("f_u", "f_v", "c_u", "c_v"), ("k1", "k2", "p1", "p2", "k3")
    columns: dict[str, Kind] = {
        **dict.fromkeys((CAMERA, part + "width", part + "height", part + "rolling_shutter_direction"), "whole"),
        **dict.fromkeys((f"{part}intrinsic.{name}" for name in pixels + bends), "number"),
        part + "extrinsic.transform": "pose",
    }
    table = segment.read(CALIBRATION, columns)
    found: dict[int, WaymoCalibration] = {}
    for row, number in enumerate(table[CAMERA].tolist()):
        if number in found or number not in NAMES:
            raise LogError(
                f"{path}: camera {number} {'stands there twice' if number in found else 'is none of 1 to 5'}"
            )
        width, height = int(table[part + "width"][row]), int(table[part + "height"][row])
        fx, fy, cx, cy = (float(table[f"{part}intrinsic.{name}"][row]) for name in pixels)
        if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE and fx > 0 and fy > 0):
            raise LogError(f"{path}: camera {number} has {width}x{height} pixels and focal lengths {fx}, {fy}")
        try:
            lens: Lens = OpenCVPinhole(**{name: float(table[f"{part}intrinsic.{name}"][row]) for name in bends})
        except LensError as error:
            raise LogError(f"{path}: camera {number}: {error}") from error
        model = CameraModel(width, height, fx, fy, cx, cy, lens=PINHOLE if lens == OpenCVPinhole() else lens)
        mount = table[part + "extrinsic.transform"][row] @ VEHICLE_FROM_OPENCV
        found[number] = WaymoCalibration(model, mount, int(table[part + "rolling_shutter_direction"][row]))
    return found


def read_images(segment: Segment) -> ImageRows:
    """Return what is known of all images, without the images. Raises `LogError`."""
    part, path = "[CameraImageComponent].", segment.file(IMAGES)
    shutter, trigger, done = (
        f"{part}rolling_shutter_params.{name}"
        for name in ("shutter", "camera_trigger_time", "camera_readout_done_time")
    )
    columns: dict[str, Kind] = {
        **dict.fromkeys((FRAME, CAMERA), "whole"),
        part + "pose.transform": "pose",
        **dict.fromkeys((part + "pose_timestamp", shutter, trigger, done), "number"),
    }
    table = segment.read(IMAGES, columns)
    first, last = table[trigger] + table[shutter] / 2, table[done] - table[shutter] / 2
    wrong = (last < first) | (last - first > MOST_EXPOSURE_S) | (table[shutter] < 0)
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(
            f"{path}: row {row} is triggered at {table[trigger][row]} s and read out at {table[done][row]} s, "
            f"exposed for {table[shutter][row]} s"
        )
    check_places(path, table[part + "pose.transform"])
    return ImageRows(
        table[CAMERA], table[FRAME], table[part + "pose.transform"], table[part + "pose_timestamp"], first, last
    )


def with_shutter(calibration: WaymoCalibration, exposure_s: float) -> CameraModel:
    """Return the model whose images are stamped with the middle of exposure, which takes ``exposure_s`` from line to line."""
    if calibration.read_out not in READ_OUT or calibration.read_out == 0:
        return calibration.model
    axis, reverse = READ_OUT[calibration.read_out]
    return replace(
        calibration.model,
        shutter=RollingShutter.of_exposure(-exposure_s / 2, exposure_s / 2, 0.0, axis=axis, reverse=reverse),
    )


def readouts_of(stamps_s: FloatArray, exposures_s: FloatArray, exposure_s: float) -> Readouts | None:
    """Return how images stamped ``stamps_s`` (K,) differ that take ``exposures_s`` (K,) in place of ``exposure_s``; None where
    that is less than a microsecond, or nothing."""
    if np.ptp(exposures_s) < SAME_S or (exposures_s <= 0).any():
        return None
    times, first = np.unique(stamps_s, return_index=True)
    return Readouts(times, exposures_s[first] / exposure_s)
