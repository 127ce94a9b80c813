"""The tables of an Argoverse 2 log besides its sweeps: poses, mounts and intrinsics; and files that are named by their time.

``a_SE3_b`` takes points of b to a; quaternions are wxyz; times are integer nanoseconds.
"""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import MAX_SIDE, Notes, files_by_stem
from ...errors import LogError
from ...geometry import FloatArray, make_pose
from ...world.drive import CameraModel
from ..common.arrow.columns import Kind, stacked, unit_quaternions
from ..common.arrow.feather import read_feather

POSES = "city_SE3_egovehicle.feather"
"""The vehicle's poses: the file that a log is recognised by."""
QUATERNION, TRANSLATION = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m")
POSE: dict[str, Kind] = dict.fromkeys((*QUATERNION, *TRANSLATION), "number")
FARTHEST_M = 1e7
"""City coordinates farther from their origin than this are no place on earth."""
T = TypeVar("T")


def read_poses(path: Path) -> tuple[NDArray[np.int64], FloatArray, FloatArray]:
    """Return times (T,) in ns, increasing; positions (T, 3) and unit quaternions (T, 4) of the vehicle in the city frame."""
    table = read_feather(path, {"timestamp_ns": "whole", **POSE})
    times = table["timestamp_ns"]
    if not len(times):
        raise LogError(f"{path}: holds no pose")
    late = np.flatnonzero(times[1:] <= times[:-1])
    if len(late):
        row = int(late[0]) + 1
        raise LogError(f"{path}: row {row} at {times[row]} ns is not later than the row before, at {times[row - 1]} ns")
    positions = stacked(table, TRANSLATION)
    far = np.abs(positions).max(1) > FARTHEST_M
    if far.any():
        row = int(far.argmax())
        raise LogError(f"{path}: row {row} is at {tuple(positions[row].tolist())} m")
    return times, positions, unit_quaternions(path, stacked(table, QUATERNION))


def read_mounts(path: Path) -> dict[str, FloatArray]:
    """Return the pose (4, 4) of each sensor in the vehicle's frame, by its name."""
    table = read_feather(path, {"sensor_name": "text", **POSE})
    poses = make_pose(stacked(table, TRANSLATION), unit_quaternions(path, stacked(table, QUATERNION)))
    return _by_name(path, table["sensor_name"].tolist(), list(poses))


def read_intrinsics(path: Path) -> dict[str, CameraModel]:
    """Return the cameras' models by name: ideal pinholes, as the published images are undistorted (k1, k2 and k3 are the lens's).

    The shutter is taken to be global: nothing states it.
    """
    numbers, sizes = ("fx_px", "fy_px", "cx_px", "cy_px"), ("width_px", "height_px")
    kinds: dict[str, Kind] = {
        "sensor_name": "text",
        **dict.fromkeys(numbers, "number"),
        **dict.fromkeys(sizes, "whole"),
    }
    table = read_feather(path, kinds)
    models = []
    for row, name in enumerate(table["sensor_name"]):
        fx, fy, cx, cy = (float(table[column][row]) for column in numbers)
        width, height = (int(table[column][row]) for column in sizes)
        if not (fx > 0 and fy > 0):
            raise LogError(f"{path}: {name} has the focal lengths {fx} and {fy} pixels")
        if not (0 < width <= MAX_SIDE and 0 < height <= MAX_SIDE):
            raise LogError(f"{path}: {name} has images of {width}x{height} pixels")
        models.append(CameraModel(width, height, fx, fy, cx, cy))
    return _by_name(path, table["sensor_name"].tolist(), models)


def _by_name(path: Path, names: list[str], values: list[T]) -> dict[str, T]:
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise LogError(f"{path}: {twice} stands there twice")
    return dict(zip(names, values, strict=True))


def stamped_files(folder: Path, suffixes: tuple[str, ...], notes: Notes | None = None) -> dict[int, Path]:
    """Return files by the nanoseconds that their names before one of ``suffixes`` are; none where the folder is absent."""
    stems = files_by_stem(folder, suffixes, notes)
    named = {int(stem): path for stem, path in stems.items() if stem.isascii() and stem.isdigit() and len(stem) < 20}
    return {stamp: path for stamp, path in sorted(named.items()) if stamp < 1 << 63}
