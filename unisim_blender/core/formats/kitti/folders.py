"""Where the files of a raw drive and of a tracking sequence lie, and when each frame was taken.

Cameras are triggered as the LiDAR looks forward, so a frame's time is that of the LiDAR's forward look; images are stamped some
10 ms after it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import Notes, image_suffixes, what_else
from ...data.values import check_angles
from ...errors import LogError
from ...geometry import FloatArray
from .boxes import read_labels, read_tracklets
from .calibration import CAMERAS, read_raw, read_tracking
from .files import (
    IMAGE_LAG_S,
    NO_STAMP,
    PERIOD_S,
    TRIGGERED_S,
    KittiFiles,
    data_folder,
    frame_files,
    numbered_lines,
    numbers,
    read_stamps,
)
from .layout import VELODYNE, beside_tracking

EARTH_M = 6378137.0
VALUES = 6
"""Number of values used of a record: latitude and longitude in degrees, altitude in metres, roll, pitch and yaw."""
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


START, FORWARD, END = "timestamps_start.txt", "timestamps.txt", "timestamps_end.txt"
IMAGES = image_suffixes(".png")
LONGEST_S = 1.0
"""No turn and no step from one frame to the next takes longer, but where frames are missing."""


def raw_files(path: Path) -> KittiFiles:
    """Return the files of the raw drive in a folder. Its calibration lies in the folder or in the day's, above it.

    Raises `LogError`.
    """
    day = path if (path / "calib_cam_to_cam.txt").exists() else path.resolve().parent
    sweeps = frame_files(path / VELODYNE, (".bin",))
    if not sweeps and frame_files(path / VELODYNE, (".txt",)):
        raise LogError(
            f"{path}: is an unsynced drive (_extract), whose sweeps are text and images not rectified: take its _sync folder"
        )
    calibration = read_raw(day)
    folders = {name: path / name for name in CAMERAS if name in calibration.projections}
    read = Notes()
    images = {name: frame_files(folder, IMAGES, read) for name, folder in folders.items()}
    notes = [*read.values(), *_strangers(folders, images)]
    oxts_files = frame_files(path / "oxts", (".txt",))
    files = KittiFiles(path.resolve().name, calibration, sweeps, images, {}, {}, notes=notes)
    clock_ns = _frame_times(files, path, path)
    _image_times(files, path, clock_ns)
    if oxts_files:
        files.oxts, files.oxts_times_s = _raw_oxts(path / "oxts", oxts_files, files, clock_ns)
    tracklets = path / "tracklet_labels.xml"
    if tracklets.is_file():
        files.boxes = read_tracklets(tracklets)
    else:
        notes.append("tracklet_labels.xml is missing: no boxes")
    return files


def tracking_files(split: Path, sequence: str) -> KittiFiles:
    """Return the files of a tracking sequence, which has no timestamps but those beside one that this program wrote.

    Raises `LogError`.
    """
    beside = beside_tracking(split, sequence)
    calibration = read_tracking(split / "calib" / f"{sequence}.txt")
    sweeps = frame_files(split / "velodyne" / sequence, (".bin",))
    folders = {name: split / name / sequence for name in CAMERAS if name in calibration.projections}
    read = Notes()
    images = {name: frame_files(folder, IMAGES, read) for name, folder in folders.items()}
    notes = [*read.values(), *_strangers(folders, images)]
    files = KittiFiles(f"tracking-{sequence}", calibration, sweeps, images, {}, {}, notes=notes)
    clock_ns = _frame_times(files, split, beside)
    _image_times(files, beside, clock_ns)
    oxts = split / "oxts" / f"{sequence}.txt"
    if oxts.is_file():
        records = read_records(oxts)
        files.oxts, files.oxts_times_s = _timed(beside / "oxts", np.arange(len(records)), records, files, clock_ns)
    labels = split / "label_02" / f"{sequence}.txt"
    if labels.is_file():
        files.boxes = read_labels(labels, calibration.camera0_from_lidar)
    else:
        files.notes.append(f"label_02/{sequence}.txt is missing: no boxes")
    return files


def _strangers(folders: dict[str, Path], images: dict[str, dict[int, Path]]) -> list[str]:
    """A sentence for each camera whose folder has other files than images."""
    found = {name: what_else(data_folder(folder)) for name, folder in folders.items() if not images[name]}
    return [f"{name}: has no image{what}" for name, what in found.items() if what]


def _frame_times(files: KittiFiles, path: Path, stamped: Path) -> int | None:
    """Fill in frames' and turns' times, whose timestamps lie in the folder ``stamped``; gives the clock's zero in nanoseconds,
    None where there are no timestamps."""
    frames = sorted({*files.sweeps, *(frame for images in files.images.values() for frame in images)})
    if not frames:
        raise LogError(f"{path}: holds neither sweeps nor images of a calibrated camera")
    found = _triggers(files, stamped)
    if found is None:
        files.notes.append(f"there are no timestamps: {PERIOD_S} s from one frame to the next are assumed")
        files.time_s = {frame: PERIOD_S * (frame - frames[0]) for frame in frames}
    else:
        source, triggers = found
        _check_count(source, triggers, frames[-1])
        lost = next((frame for frame in frames if triggers[frame] == NO_STAMP), None)
        if lost is not None:
            raise LogError(f"{source}: line {lost + 1} is empty, but there is a frame {lost}")
        files.time_s = {frame: (int(triggers[frame]) - int(triggers[frames[0]])) * 1e-9 for frame in frames}
        for before, after in zip(frames, frames[1:], strict=False):
            step = files.time_s[after] - files.time_s[before]
            if not 1e-3 < step < LONGEST_S * (after - before):
                raise LogError(f"{source}: frame {after} is {step:.6g} s after frame {before}")
    clock_ns = None if found is None else int(found[1][frames[0]])
    _turns(files, stamped / VELODYNE, clock_ns)
    return clock_ns


def _triggers(files: KittiFiles, path: Path) -> tuple[Path, NDArray[np.int64]] | None:
    """When the LiDAR looked forward, nanoseconds by frame, and the file that says so; of a frame without a sweep, and without a
    time of one, by its images."""
    own = path / VELODYNE / FORWARD
    found = read_stamps(own) if own.is_file() else None
    source = own
    for name, images in files.images.items():
        if found is not None and (found != NO_STAMP).all():
            break
        stamps = path / name / "timestamps.txt"
        if not images or not stamps.is_file():
            continue
        shot = read_stamps(stamps)
        shot = np.where(shot == NO_STAMP, NO_STAMP, shot - round(IMAGE_LAG_S * 1e9))
        if found is None:
            found, source = shot, stamps
        else:
            shared = min(len(found), len(shot))
            found[:shared] = np.where(found[:shared] == NO_STAMP, shot[:shared], found[:shared])
    return None if found is None else (source, found)


def _turns(files: KittiFiles, folder: Path, clock_ns: int | None) -> None:
    """Fill in when the LiDAR looked backward before and after each sweep's forward look."""
    ends = [folder / START, folder / END]
    if clock_ns is None or not all(end.is_file() for end in ends):
        half = PERIOD_S / 2
        files.turns = {f: (files.time_s[f] - half, files.time_s[f], files.time_s[f] + half) for f in files.sweeps}
        return
    start, end = (read_stamps(one) for one in ends)
    for one, stamps in zip(ends, (start, end), strict=True):
        _check_count(one, stamps, max(files.sweeps, default=0))
    for frame in sorted(files.sweeps):
        if NO_STAMP in (start[frame], end[frame]):
            forward, half = files.time_s[frame], PERIOD_S / 2
            files.turns[frame] = forward - half, forward, forward + half
            continue
        before, after = (int(start[frame]) - clock_ns) * 1e-9, (int(end[frame]) - clock_ns) * 1e-9
        forward = files.time_s[frame]
        if not (before < forward < after and after - before < LONGEST_S):
            raise LogError(
                f"{folder}: the turn of frame {frame} starts {forward - before:.6g} s before and ends "
                f"{after - forward:.6g} s after it looks forward"
            )
        files.turns[frame] = (before, forward, after)


def _image_times(files: KittiFiles, path: Path, clock_ns: int | None) -> None:
    """Fill in the images' own times of cameras whose stamps are not those of the LiDAR's triggers."""
    for name, images in files.images.items():
        stamps = path / name / "timestamps.txt"
        if clock_ns is None or not images or not stamps.is_file():
            continue
        found = read_stamps(stamps)
        _check_count(stamps, found, max(images))
        own = {
            frame: (int(found[frame]) - clock_ns) * 1e-9 - IMAGE_LAG_S for frame in images if found[frame] != NO_STAMP
        }
        late = [abs(time - files.time_s[frame]) for frame, time in own.items()]
        if late and sorted(late)[len(late) // 2] > TRIGGERED_S:
            files.image_times[name] = own


def _check_count(path: Path, stamps: NDArray[np.int64], last: int) -> None:
    if last >= len(stamps):
        raise LogError(f"{path}: holds {len(stamps)} timestamps, too few for frame {last}")


def _raw_oxts(
    folder: Path, records: dict[int, Path], files: KittiFiles, clock_ns: int | None
) -> tuple[FloatArray, FloatArray]:
    """The IMU's records (T, 6) and their times (T,), in order."""
    numbers = sorted(records)
    values = []
    for number in numbers:
        line = next(numbered_lines(records[number]), None)
        if line is None:
            raise LogError(f"{records[number]}: is empty")
        values.append(read_record(records[number], *line))
    return _timed(folder, np.array(numbers), np.stack(values), files, clock_ns)


def _timed(
    folder: Path, numbers: NDArray[np.int64], records: FloatArray, files: KittiFiles, clock_ns: int | None
) -> tuple[FloatArray, FloatArray]:
    """The IMU's records (T, 6), numbered as frames are, and when they were taken (T,): by the folder's timestamps, where it has
    them; a record without one is left out."""
    stamps = folder / "timestamps.txt"
    if clock_ns is None or not stamps.is_file():
        return records, PERIOD_S * (numbers.astype(np.float64) - min(files.time_s))
    found = read_stamps(stamps)
    _check_count(stamps, found, int(numbers[-1]))
    there = found[numbers] != NO_STAMP
    numbers, records = numbers[there], records[there]
    times = (found[numbers] - clock_ns) * 1e-9
    late = np.flatnonzero(np.diff(times) < 1e-6)
    if len(late):
        raise LogError(f"{stamps}: record {numbers[int(late[0]) + 1]} is not later than the one before it")
    return records, np.asarray(times)
