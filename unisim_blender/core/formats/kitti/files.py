"""Files of a KITTI drive, whichever of its layouts they lie in, and how text, sweeps and calibration are read."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import MAX_SIDE, Notes, files_by_stem
from ...errors import LogError, in_a_line, short
from ...geometry import FloatArray, nearest_rotation
from ..common.file_log import read_text

MAX_SWEEP_BYTES = 64 * 2**20
"""A sweep of 114 000 points has 1.8 MB."""
PERIOD_S = 0.1
"""From one frame to the next, where a drive has no timestamps."""
IMAGE_LAG_S = 0.010
"""How long after the trigger images are stamped; measured on a raw drive, all four cameras within 1 ms."""
TRIGGERED_S = 0.002
"""An image stamped further from where the LiDAR's trigger puts it was not triggered by it."""
NO_STAMP = np.iinfo(np.int64).min
"""In place of a timestamp whose line is empty: of a sweep that was lost, as in the dataset's drive 2011_09_26_drive_0009."""
FARTHEST_M = 1e4
"""A point further than this is an error."""


@dataclass(frozen=True)
class KittiCalibration:
    """Rigid poses (4, 4) of the LiDAR's frame in the first rectified camera's, and of the IMU's in the LiDAR's (None where it is
    not given). ``projections``: P_rect (3, 4) by camera, "image_02"."""

    camera0_from_lidar: FloatArray
    projections: dict[str, FloatArray]
    lidar_from_imu: FloatArray | None
    sizes: dict[str, tuple[int, int]] = field(default_factory=dict)
    """Width and height that images are rectified to, S_rect, by camera; a raw drive's calibration has them."""


@dataclass(frozen=True)
class BoxRecord:
    """A box at one frame: its centre's pose (4, 4) in the LiDAR's frame, x forward, and size (3,): length, width, height;
    ``score``: a tracker's, None of a label."""

    uid: str
    label: str
    frame: int
    lidar_from_box: FloatArray
    size_m: FloatArray
    score: float | None = None


@dataclass
class KittiFiles:
    """A drive's files by frame; times are seconds from its first frame.

    ``turns``: of a frame's sweep, when the LiDAR looked backward, forward, and backward again. ``oxts``: the IMU's records
    (T, 6), latitude, longitude, altitude, roll, pitch, yaw, at ``oxts_times_s`` (T,); None where there are none. ``notes``: a
    sentence for each thing that is not there. ``clock_ns``: the first frame's timestamp; None where there is none.
    """

    name: str
    calibration: KittiCalibration
    sweeps: dict[int, Path]
    images: dict[str, dict[int, Path]]
    time_s: dict[int, float]
    turns: dict[int, tuple[float, float, float]]
    oxts: FloatArray | None = None
    oxts_times_s: FloatArray | None = None
    clock_ns: int | None = None
    boxes: list[BoxRecord] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    image_times: dict[str, dict[int, float]] = field(default_factory=dict)
    """Of cameras that the LiDAR does not trigger."""


def numbered_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Give the lines of a text file that are not empty, with their numbers from 1."""
    for number, line in enumerate(read_text(path).splitlines(), 1):
        if line.strip():
            yield number, line.strip()


def numbers(path: Path, where: str, words: list[str]) -> FloatArray:
    """Return words of a file as finite numbers. Raises `LogError`."""
    try:
        values = np.array([float(word) for word in words])
    except ValueError as error:
        raise LogError(f"{path}: {where} holds what is no number ({in_a_line(error)})") from error
    if not np.isfinite(values).all():
        raise LogError(f"{path}: {where} holds a number that is not finite")
    return values


def rows_of_numbers(path: Path, rows: list[tuple[str, list[str]]]) -> FloatArray:
    """Return rows of K words each, after the words for where they stand, as finite numbers (N, K). Raises `LogError`."""
    try:
        values = np.array([[float(word) for word in words] for _, words in rows])
    except ValueError:
        values = np.full(1, np.nan)
    if not np.isfinite(values).all():  # one by one, to say which
        values = np.stack([numbers(path, where, words) for where, words in rows])
    return values


def read_stamps(path: Path) -> NDArray[np.int64]:
    """Return a file of timestamps, "2011-09-26 13:02:25.967790592" a line, as nanoseconds (T,); `NO_STAMP` for an empty line.
    Raises `LogError`.
    """
    stamps: list[int] = []
    for number, line in numbered_lines(path):
        stamps += [NO_STAMP] * (number - 1 - len(stamps))
        try:
            stamp = np.datetime64(line.replace(" ", "T", 1), "ns")
        except ValueError as error:
            raise LogError(f"{path}: line {number} is no timestamp: {short(line)}") from error
        if np.isnat(stamp) or not 1970 <= int(line[:4] if line[:4].isdigit() else 0) <= 2200:
            raise LogError(f"{path}: line {number} is no timestamp: {short(line)}")
        stamps.append(int(stamp.astype(np.int64)))
    if not stamps:
        raise LogError(f"{path}: holds no timestamp")
    return np.array(stamps, np.int64)


def frame_files(folder: Path, suffixes: tuple[str, ...], notes: Notes | None = None) -> dict[int, Path]:
    """Return files by frame, which is the number before one of ``suffixes``; in ``folder``, or in its data/ where it has one."""
    files: dict[int, Path] = {}
    for stem, path in files_by_stem(data_folder(folder), suffixes, notes).items():
        if not stem.isascii() or not stem.isdigit() or len(stem) > 10:
            continue
        if int(stem) in files:
            raise LogError(f"{path}: is frame {int(stem)}, and so is {files[int(stem)].name}")
        files[int(stem)] = path
    return files


def data_folder(folder: Path) -> Path:
    """Return where a sensor's files lie: in data/ of its folder, where there is one."""
    return folder / "data" if (folder / "data").is_dir() else folder


def read_points(path: Path) -> NDArray[np.float64]:
    """Return a sweep (N, 4): x, y, z in metres, reflectance in 0..1, each point in the sensor's frame at its own time.

    Points in the sensor itself are left out. Raises `LogError`.
    """
    try:
        size = path.stat().st_size
        if size > MAX_SWEEP_BYTES:
            raise LogError(f"{path}: refused, it has more than {MAX_SWEEP_BYTES // 2**20} MiB")
        if size % 16:
            raise LogError(f"{path}: is cut off, its {size} bytes are no whole number of points of 16 bytes")
        values = np.fromfile(path, "<f4").reshape(-1, 4).astype(np.float64)
    except FileNotFoundError as error:
        raise LogError(f"{path}: is missing") from error
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read ({in_a_line(error)})") from error
    bad = ~np.isfinite(values).all(1) | (np.abs(values[:, :3]).max(1, initial=0) > FARTHEST_M)
    if bad.any():
        x, y, z, bright = values[bad.argmax()].tolist()
        raise LogError(f"{path}: point {int(bad.argmax())} is at {[x, y, z]}, its intensity is {bright}")
    return values[np.hypot(values[:, 0], values[:, 1]) > 0]


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
        name_there = next((other for other in others if other in values), None)
        if name_there is not None:
            values[name] = values[name_there]
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
