"""Where the files of a raw drive and of a tracking sequence lie, when each frame was taken, and their boxes.

Cameras are triggered as the LiDAR looks forward, so a frame's time is that of the LiDAR's forward look; images are stamped some
10 ms after it.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import Notes, image_suffixes, what_else
from ...data.values import check_angles
from ...errors import LogError, in_a_line, short
from ...geometry import FloatArray, invert_pose, make_pose, quaternion_from_yaw
from ..common.file_log import read_text
from . import VELODYNE, beside_tracking
from .files import (
    CAMERAS,
    IMAGE_LAG_S,
    NO_STAMP,
    PERIOD_S,
    TRIGGERED_S,
    BoxRecord,
    KittiFiles,
    data_folder,
    frame_files,
    numbered_lines,
    numbers,
    read_raw,
    read_stamps,
    read_tracking,
    rows_of_numbers,
)

NO_OBJECT = "DontCare"
"""Tracking labels mark parts of an image so that hold objects too far away to be annotated."""
LABEL_WORDS = 17
"""Number of values of a label; a tracker's result has its score after them."""
CAMERA_FROM_UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
"""A box's axes (x forward, y left, z up) in the camera's (x right, y down, z forward) for rotation_y 0."""


def read_tracklets(path: Path) -> list[BoxRecord]:
    """Return the boxes of a raw drive: in the LiDAR's frame, by the centre of their bottom. Raises `LogError`."""
    text = read_text(path)
    if "<!ENTITY" in text:
        raise LogError(f"{path}: refused, it declares entities")
    try:
        root = ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError, RecursionError) as error:
        raise LogError(f"{path}: is not valid XML ({in_a_line(error)})") from error
    tracklets = root.find("tracklets")
    if tracklets is None:
        raise LogError(f"{path}: has no tracklets")
    boxes: list[BoxRecord] = []
    for index, item in enumerate(tracklets.findall("item")):
        where = f"tracklet {index}"
        label = (item.findtext("objectType") or "").strip()
        if not label:
            raise LogError(f"{path}: {where} has no objectType")
        size = np.array([_number(path, item, where, key) for key in ("l", "w", "h")])
        first = int(_number(path, item, where, "first_frame"))
        _check_size(path, where, size)
        if first < 0:
            raise LogError(f"{path}: {where} begins at frame {first}")
        uid, poses = f"{label.lower()}-{index:04d}", item.findall("poses/item")
        values = _placed(path, where, poses)
        lidar_from_box = make_pose(values[:, :3] + [0, 0, size[2] / 2], quaternion_from_yaw(values[:, 3]))
        boxes += [BoxRecord(uid, label, first + step, pose, size) for step, pose in enumerate(lidar_from_box)]
    return boxes


def read_labels(path: Path, camera0_from_lidar: FloatArray) -> list[BoxRecord]:
    """Return the boxes of a tracking sequence: in the first rectified camera's frame, by the centre of their bottom, y down.

    Raises `LogError`.
    """
    named: list[tuple[str, str, int]] = []
    rows: list[tuple[str, list[str]]] = []
    there: set[tuple[str, int]] = set()
    scores: list[float | None] = []
    for line, text in numbered_lines(path):
        words, where = text.split(), f"line {line}"
        if len(words) < LABEL_WORDS:
            raise LogError(f"{path}: {where} is no label, it has {len(words)} values, not {LABEL_WORDS}")
        if words[2] == NO_OBJECT:
            continue
        try:
            frame, track = int(words[0]), int(words[1])
        except ValueError as error:
            raise LogError(f"{path}: {where} has no numbers of frame and track ({in_a_line(error)})") from error
        uid = f"{words[2].lower()}-{track:04d}"
        if frame < 0 or (uid, frame) in there:
            raise LogError(f"{path}: {where} gives {uid} twice" if frame >= 0 else f"{path}: {where} is frame {frame}")
        there.add((uid, frame))
        named.append((uid, words[2], frame))
        rows.append((where, words[10:LABEL_WORDS]))
        scores.append(float(numbers(path, where, words[LABEL_WORDS:])[0]) if len(words) > LABEL_WORDS else None)
    height, width, length, x, y, z, turned = rows_of_numbers(path, rows).reshape(-1, LABEL_WORDS - 10).T
    check_angles(path, "a label's rotation_y", turned)
    sizes = np.stack([length, width, height], 1)
    wrong = ~_is_size(sizes)
    if wrong.any():
        _check_size(path, rows[int(wrong.argmax())][0], sizes[wrong.argmax()])
    about_y = np.zeros((len(rows), 3, 3))
    about_y[:, 0, 0] = about_y[:, 2, 2] = np.cos(turned)
    about_y[:, 0, 2], about_y[:, 2, 0], about_y[:, 1, 1] = np.sin(turned), -np.sin(turned), 1
    poses = np.tile(np.eye(4), (len(rows), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = about_y @ CAMERA_FROM_UPRIGHT, np.stack([x, y - height / 2, z], 1)
    return [
        BoxRecord(*label, pose, size, score)
        for label, pose, size, score in zip(named, invert_pose(camera0_from_lidar) @ poses, sizes, scores, strict=True)
    ]


def _placed(path: Path, where: str, poses: list[ElementTree.Element]) -> FloatArray:
    """Places and headings (T, 4) of a tracklet's poses."""
    keys = ("tx", "ty", "tz", "rz")
    try:
        values = np.array([[float(pose.findtext(key, "")) for key in keys] for pose in poses])
    except ValueError:
        values = np.full((1, 4), np.nan)
    if not np.isfinite(values).all():  # one by one, to say which
        values = np.array(
            [[_number(path, pose, f"{where}, pose {step}", key) for key in keys] for step, pose in enumerate(poses)]
        )
    check_angles(path, f"{where}: rz", values.reshape(-1, 4)[:, 3])
    return values.reshape(-1, 4)


def _number(path: Path, node: ElementTree.Element, where: str, key: str) -> float:
    text = node.findtext(key)
    if text is None:
        raise LogError(f"{path}: {where} has no {key}")
    return float(numbers(path, f"{where}: {key}", [text])[0])


def _check_size(path: Path, where: str, size_m: FloatArray) -> None:
    if not _is_size(size_m):
        raise LogError(f"{path}: {where} has the size {short(tuple(size_m.tolist()))} m")


def _is_size(size_m: FloatArray) -> NDArray[np.bool_]:
    return np.asarray(((size_m > 0) & (size_m < 1e3)).all(-1))


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
    records = [read_record(path, number, line) for number, line in numbered_lines(path)]
    if not records:
        raise LogError(f"{path}: holds no record")
    return np.stack(records)


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
    files.clock_ns = clock_ns = _frame_times(files, path, path)
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
    others = {name: what_else(data_folder(folder)) for name, folder in folders.items() if not images[name]}
    return [f"{name}: has no image{what}" for name, what in others.items() if what]


def _frame_times(files: KittiFiles, path: Path, stamped: Path) -> int | None:
    """Fill in frames' and turns' times, whose timestamps lie in the folder ``stamped``; gives the clock's zero in nanoseconds,
    None where there are no timestamps."""
    frames = sorted({*files.sweeps, *(frame for images in files.images.values() for frame in images)})
    if not frames:
        raise LogError(f"{path}: holds neither sweeps nor images of a calibrated camera")
    stamps = _triggers(files, stamped)
    if stamps is None:
        files.notes.append(f"there are no timestamps: {PERIOD_S} s from one frame to the next are assumed")
        files.time_s = {frame: PERIOD_S * (frame - frames[0]) for frame in frames}
    else:
        source, triggers = stamps
        _check_count(source, triggers, frames[-1])
        lost = next((frame for frame in frames if triggers[frame] == NO_STAMP), None)
        if lost is not None:
            raise LogError(f"{source}: line {lost + 1} is empty, but there is a frame {lost}")
        files.time_s = {frame: (int(triggers[frame]) - int(triggers[frames[0]])) * 1e-9 for frame in frames}
        for before, after in zip(frames, frames[1:], strict=False):
            step = files.time_s[after] - files.time_s[before]
            if not 1e-3 < step < LONGEST_S * (after - before):
                raise LogError(f"{source}: frame {after} is {step:.6g} s after frame {before}")
    clock_ns = None if stamps is None else int(stamps[1][frames[0]])
    _turns(files, stamped / VELODYNE, clock_ns)
    return clock_ns


def _triggers(files: KittiFiles, path: Path) -> tuple[Path, NDArray[np.int64]] | None:
    """When the LiDAR looked forward, nanoseconds by frame, and the file that says so; of a frame without a sweep, and without a
    time of one, by its images."""
    own = path / VELODYNE / FORWARD
    times = read_stamps(own) if own.is_file() else None
    source = own
    for name, images in files.images.items():
        if times is not None and (times != NO_STAMP).all():
            break
        stamps = path / name / "timestamps.txt"
        if not images or not stamps.is_file():
            continue
        shot = read_stamps(stamps)
        shot = np.where(shot == NO_STAMP, NO_STAMP, shot - round(IMAGE_LAG_S * 1e9))
        if times is None:
            times, source = shot, stamps
        else:
            shared = min(len(times), len(shot))
            times[:shared] = np.where(times[:shared] == NO_STAMP, shot[:shared], times[:shared])
    return None if times is None else (source, times)


def _turns(files: KittiFiles, folder: Path, clock_ns: int | None) -> None:
    """Fill in when the LiDAR looked backward before and after each sweep's forward look."""
    ends = [folder / START, folder / END]
    if clock_ns is None or not all(end.is_file() for end in ends):
        half = PERIOD_S / 2
        files.turns = {f: (files.time_s[f] - half, files.time_s[f], files.time_s[f] + half) for f in files.sweeps}
        return
    start, end = (read_stamps(path) for path in ends)
    for path, stamps in zip(ends, (start, end), strict=True):
        _check_count(path, stamps, max(files.sweeps, default=0))
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
        times = read_stamps(stamps)
        _check_count(stamps, times, max(images))
        own = {
            frame: (int(times[frame]) - clock_ns) * 1e-9 - IMAGE_LAG_S for frame in images if times[frame] != NO_STAMP
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
    times = read_stamps(stamps)
    _check_count(stamps, times, int(numbers[-1]))
    there = times[numbers] != NO_STAMP
    numbers, records = numbers[there], records[there]
    times_s = (times[numbers] - clock_ns) * 1e-9
    late = np.flatnonzero(np.diff(times_s) < 1e-6)
    if len(late):
        raise LogError(f"{stamps}: record {numbers[int(late[0]) + 1]} is not later than the one before it")
    return records, np.asarray(times_s)
