"""KITTI's calibration files: `calib_*.txt` of a raw drive's day, and a tracking sequence's one file."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...data.image_files import MAX_SIDE
from ...errors import LogError
from ...geometry import FloatArray, nearest_rotation
from .files import KittiCalibration, numbered_lines, numbers

RIGID = 1e-3
CAMERAS = ("image_00", "image_01", "image_02", "image_03")


def read_raw(folder: Path) -> KittiCalibration:
    """Return the calibration in a day's folder. Raises `LogError`."""
    path = folder / "calib_cam_to_cam.txt"
    cameras = _read_values(path)
    lidar = folder / "calib_velo_to_cam.txt"
    imu = folder / "calib_imu_to_velo.txt"
    rectified = _rotation(path, cameras, "R_rect_00")
    return KittiCalibration(
        camera0_from_lidar=rectified @ _rigid(lidar, _read_values(lidar)),
        projections={
            name: _projection(path, cameras, f"P_rect_{name[-2:]}")
            for name in CAMERAS
            if f"P_rect_{name[-2:]}" in cameras
        },
        lidar_from_imu=_rigid(imu, _read_values(imu)) if imu.is_file() else None,
        sizes={
            name: _size(path, cameras, f"S_rect_{name[-2:]}") for name in CAMERAS if f"S_rect_{name[-2:]}" in cameras
        },
    )


def read_tracking(path: Path) -> KittiCalibration:
    """Return a tracking sequence's calibration. Raises `LogError`."""
    values = _read_values(path)
    names = {
        "R_rect": ("R_rect", "R0_rect"),
        "Tr_velo_cam": ("Tr_velo_cam", "Tr_velo_to_cam"),
        "Tr_imu_velo": ("Tr_imu_velo", "Tr_imu_to_velo"),
    }
    for name, others in names.items():
        found = next((other for other in others if other in values), None)
        if found is not None:
            values[name] = values[found]
    return KittiCalibration(
        camera0_from_lidar=_rotation(path, values, "R_rect") @ _pose(path, values, "Tr_velo_cam"),
        projections={name: _projection(path, values, f"P{name[-1]}") for name in CAMERAS if f"P{name[-1]}" in values},
        lidar_from_imu=_pose(path, values, "Tr_imu_velo") if "Tr_imu_velo" in values else None,
    )


def intrinsics(projection: FloatArray) -> tuple[tuple[float, float, float, float], FloatArray]:
    """Return fx, fy, cx, cy in pixels, and the pose (4, 4) of the first rectified camera's frame in this one's."""
    camera_from_camera0 = np.eye(4)
    camera_from_camera0[:3, 3] = np.linalg.solve(projection[:, :3], projection[:, 3])
    fx, fy, cx, cy = (float(projection[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    # the projection counts pixels from the first one's centre
    return (fx, fy, cx + 0.5, cy + 0.5), camera_from_camera0


def _read_values(path: Path) -> dict[str, FloatArray]:
    values: dict[str, FloatArray] = {}
    for number, line in numbered_lines(path):
        words = line.split()
        key = words[0].removesuffix(":")
        if key != "calib_time":
            values[key] = numbers(path, f"{key} (line {number})", words[1:])
    return values


def _of(path: Path, values: dict[str, FloatArray], key: str, shape: tuple[int, ...]) -> FloatArray:
    if key not in values:
        raise LogError(f"{path}: {key} is missing")
    if values[key].size != np.prod(shape):
        raise LogError(f"{path}: {key} has {values[key].size} numbers, not {np.prod(shape)}")
    return values[key].reshape(shape)


def _projection(path: Path, values: dict[str, FloatArray], key: str) -> FloatArray:
    projection = _of(path, values, key, (3, 4))
    left = projection[:, :3]
    if not (left[0, 0] > 0 and left[1, 1] > 0 and np.array_equal(left[2], [0, 0, 1]) and abs(left[1, 0]) < 1e-9):
        raise LogError(f"{path}: {key} is no projection of a rectified camera")
    return projection


def _size(path: Path, values: dict[str, FloatArray], key: str) -> tuple[int, int]:
    width, height = _of(path, values, key, (2,)).tolist()
    if not (0 < width < MAX_SIDE and 0 < height < MAX_SIDE):
        raise LogError(f"{path}: {key} is {width:g}x{height:g} pixels")
    return round(width), round(height)


def _rotation(path: Path, values: dict[str, FloatArray], key: str) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3] = _of(path, values, key, (3, 3))
    return _checked(path, key, pose)


def _pose(path: Path, values: dict[str, FloatArray], key: str) -> FloatArray:
    return _checked(path, key, np.vstack([_of(path, values, key, (3, 4)), [0, 0, 0, 1]]))


def _rigid(path: Path, values: dict[str, FloatArray]) -> FloatArray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = _of(path, values, "R", (3, 3)), _of(path, values, "T", (3,))
    return _checked(path, "R", pose)


def _checked(path: Path, key: str, pose: FloatArray) -> FloatArray:
    """The pose with its rotation made one to the last bit: files give seven digits."""
    rotation = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not off <= RIGID or np.linalg.det(rotation) < 0:
        raise LogError(f"{path}: {key} is no rotation")
    exact = pose.copy()
    exact[:3, :3] = nearest_rotation(rotation)
    return exact
