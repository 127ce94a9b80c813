"""The tables of an Argoverse 2 log besides its sweeps: poses, mounts and intrinsics; and files that are named by their time.

``a_SE3_b`` takes points of b to a; quaternions are wxyz; times are integer nanoseconds.

A box is given in the vehicle's frame at its sweep's timestamp, and drawn around returns that were moved there as if all stood
still: where an object moves, they are where the beams passed it. Two LiDARs pass it, half a turn apart, so the box is keyed at
the mean of both times.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from ...data.image_files import MAX_SIDE, Notes, files_by_stem
from ...errors import LogError
from ...geometry import FloatArray, Trajectory, make_pose
from ...world.box_tracks import TrackedBoxes, passing_times
from ...world.drive import CameraModel, Lidar
from ..common.arrow import ArrowColumns, Kind, feather_names, read_feather, stacked, unit_quaternions


def read_boxes(path: Path) -> ArrowColumns:
    """Return the table of boxes, by time: annotations, or detections, whose ``track_uuid`` is "" where they are of no
    track; ``score``, 1 of annotations. Raises `LogError`."""
    there = feather_names(path)
    scored: dict[str, Kind] = {"score": "number"} if "score" in there else {}
    untracked = bool(scored) and "track_uuid" not in there
    table = read_feather(
        path, {name: kind for name, kind in COLUMNS.items() if name != "track_uuid" or not untracked} | scored
    )
    count = len(table["category"])
    table = {"track_uuid": np.full(count, ""), "score": np.ones(count)} | table
    sizes = stacked(table, SIZE)
    wrong = (sizes <= 0).any(1)
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(f"{path}: box {table['track_uuid'][row]} has the size {tuple(sizes[row].tolist())} m")
    order = np.argsort(table["timestamp_ns"], kind="stable")
    return {name: values[order] for name, values in table.items()}


def tracked_boxes(
    path: Path, table: ArrowColumns, frame_times: FloatArray, ego: Trajectory, lidars: Sequence[Lidar]
) -> TrackedBoxes:
    """Return the boxes of a table, N of them, in the world: ``frame_times`` (N,) their times, seconds; ``ego``:
    world_from_ego."""
    in_ego = make_pose(stacked(table, TRANSLATION), unit_quaternions(path, stacked(table, QUATERNION)))
    poses = ego.at(frame_times) @ in_ego
    key_s, sizes = box_times(poses[:, :3, 3], frame_times, lidars), stacked(table, SIZE)
    return TrackedBoxes(table["track_uuid"], table["category"], frame_times, poses, sizes, key_s, table["score"])


def box_times(positions: FloatArray, frame_times_s: FloatArray, lidars: Sequence[Lidar]) -> NDArray[np.float64]:
    """Return when the beams passed boxes' centres (N, 3) of the sweeps at ``frame_times_s`` (N,); those times without a LiDAR."""
    if not lidars or not len(positions):
        return frame_times_s
    return np.asarray(np.mean([passing_times(lidar, positions, frame_times_s) for lidar in lidars], axis=0))


POSES = "city_SE3_egovehicle.feather"
"""The vehicle's poses: the file that a log is recognised by."""
QUATERNION, TRANSLATION = ("qw", "qx", "qy", "qz"), ("tx_m", "ty_m", "tz_m")
POSE: dict[str, Kind] = dict.fromkeys((*QUATERNION, *TRANSLATION), "number")
SIZE = ("length_m", "width_m", "height_m")
COLUMNS: dict[str, Kind] = {
    "timestamp_ns": "whole",
    "track_uuid": "text",
    "category": "text",
    **POSE,
    **dict.fromkeys(SIZE, "number"),
}
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
