"""The IMU's records to poses: Mercator, scaled for the first latitude, and altitude (KITTI's raw devkit, `convertOxtsToPose`)."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...data.values import check_angles
from ...errors import LogError
from ...geometry import FloatArray
from .files import numbered_lines, numbers

EARTH_M = 6378137.0
VALUES = 6
"""What is used of a record: latitude and longitude in degrees, altitude in metres, roll, pitch and yaw."""
LATITUDE_LIMIT_DEG = 85.0
"""Mercator goes no further."""


def read_record(path: Path, number: int, line: str) -> FloatArray:
    """Return the record (6,) in a line. Raises `LogError`."""
    words = line.split()
    if len(words) < VALUES:
        raise LogError(f"{path}: line {number} is no record, it has {len(words)} values")
    record = numbers(path, f"line {number}", words[:VALUES])
    if abs(record[0]) > LATITUDE_LIMIT_DEG or abs(record[1]) > 360:
        raise LogError(f"{path}: line {number} is no place on earth: {record[0]}, {record[1]} degrees")
    check_angles(path, f"line {number}: roll, pitch or yaw", record[3:])
    return record


def read_records(path: Path) -> FloatArray:
    """Return all records (T, 6) of a file. Raises `LogError`."""
    found = [read_record(path, number, line) for number, line in numbered_lines(path)]
    if not found:
        raise LogError(f"{path}: holds no record")
    return np.stack(found)


def imu_poses(records: FloatArray) -> FloatArray:
    """Return the poses (T, 4, 4) of the IMU, x forward, y left, z up, in metres east, north and up."""
    latitude, longitude, altitude, roll, pitch, yaw = records.T
    scale = np.cos(np.radians(latitude[0]))
    poses = np.zeros((len(records), 4, 4))
    poses[:, 0, 3] = scale * EARTH_M * np.radians(longitude)
    poses[:, 1, 3] = scale * EARTH_M * np.log(np.tan(np.radians(90 + latitude) / 2))
    poses[:, 2, 3] = altitude
    poses[:, :3, :3] = _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)
    poses[:, 3, 3] = 1
    return poses


def _about(axis: int, angle: FloatArray) -> FloatArray:
    """Rotations (T, 3, 3) about a coordinate axis."""
    first, second = (axis + 1) % 3, (axis + 2) % 3
    out = np.zeros((len(angle), 3, 3))
    out[:, axis, axis] = 1
    out[:, first, first] = out[:, second, second] = np.cos(angle)
    out[:, second, first], out[:, first, second] = np.sin(angle), -np.sin(angle)
    return out
