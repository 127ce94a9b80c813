"""Argoverse 2's annotations to actors.

A box is given in the vehicle's frame at its sweep's timestamp, and drawn around returns that were moved there as if all stood
still: where an object moves, they are where the beams passed it. Two LiDARs pass it, half a turn apart, so the box is keyed at
the mean of both times.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ...geometry import FloatArray, Trajectory, make_pose
from ...world.drive import Actor, Lidar
from ..common.arrow.columns import ArrowColumns, Kind, stacked, unit_quaternions
from ..common.arrow.feather import read_feather
from ..common.box_tracks import TrackedBoxes, actors_of_boxes, passing_times
from .files import POSE, QUATERNION, TRANSLATION

SIZE = ("length_m", "width_m", "height_m")
COLUMNS: dict[str, Kind] = {
    "timestamp_ns": "whole",
    "track_uuid": "text",
    "category": "text",
    **POSE,
    **dict.fromkeys(SIZE, "number"),
}


def read_boxes(path: Path) -> ArrowColumns:
    """Return the table of boxes, by time. Raises `LogError`."""
    table = read_feather(path, COLUMNS)
    sizes = stacked(table, SIZE)
    wrong = (sizes <= 0).any(1)
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(f"{path}: box {table['track_uuid'][row]} has the size {tuple(sizes[row].tolist())} m")
    order = np.argsort(table["timestamp_ns"], kind="stable")
    return {name: values[order] for name, values in table.items()}


def actors_of(
    path: Path, table: ArrowColumns, stamp_s: Mapping[int, float], ego: Trajectory, lidars: Sequence[Lidar]
) -> dict[str, Actor]:
    """Return actors by uuid. ``stamp_s`` has the drive's seconds of every nanosecond of the table; ``ego``: world_from_ego."""
    frame_times = np.array([stamp_s[stamp] for stamp in table["timestamp_ns"].tolist()])
    in_ego = make_pose(stacked(table, TRANSLATION), unit_quaternions(path, stacked(table, QUATERNION)))
    poses = ego.at(frame_times) @ in_ego
    key_s = box_times(poses[:, :3, 3], frame_times, lidars)
    boxes = TrackedBoxes(table["track_uuid"], table["category"], frame_times, poses, stacked(table, SIZE), key_s)
    return actors_of_boxes(path, boxes)


def box_times(positions: FloatArray, frame_times_s: FloatArray, lidars: Sequence[Lidar]) -> NDArray[np.float64]:
    """Return when the beams passed boxes' centres (N, 3) of the sweeps at ``frame_times_s`` (N,); those times without a LiDAR."""
    if not lidars or not len(positions):
        return frame_times_s
    return np.asarray(np.mean([passing_times(lidar, positions, frame_times_s) for lidar in lidars], axis=0))
