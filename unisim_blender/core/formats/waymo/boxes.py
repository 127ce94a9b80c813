"""Waymo's boxes to actors.

A box is given in the vehicle's frame of its frame's pose, upright. Moving objects' returns are where the top LiDAR's beams passed
them, and so is the box.
"""

from __future__ import annotations

import numpy as np

from ...data.values import check_angles
from ...errors import LogError
from ...geometry import FloatArray, make_pose, quaternion_from_yaw
from ...world.drive import Actor, Lidar
from ..common.arrow.columns import Kind, stacked
from ..common.box_tracks import TrackedBoxes, actors_of_boxes, passing_times
from .segment import FRAME, Segment

BOXES = "lidar_box"
TYPES = ("TYPE_UNKNOWN", "TYPE_VEHICLE", "TYPE_PEDESTRIAN", "TYPE_SIGN", "TYPE_CYCLIST")

POSE_DELAY_S = 0.05
"""A frame's pose is the vehicle's so long after the frame's timestamp, in the middle of the turn."""


def read_actors(
    segment: Segment, time_s: dict[int, float], frame_poses: dict[int, FloatArray], lidar: Lidar | None
) -> dict[str, Actor]:
    """Return actors by the ids of the dataset. ``time_s``, ``frame_poses`` (4, 4): of frames by their timestamps; without a
    LiDAR, boxes are keyed in the middle of its turn, when the frame's pose is. Raises `LogError`."""
    path, part = segment.file(BOXES), "[LiDARBoxComponent]."
    uid, kind, heading = "key.laser_object_id", part + "type", part + "box.heading"
    centre, size = (tuple(f"{part}box.{what}.{axis}" for axis in "xyz") for what in ("center", "size"))
    columns: dict[str, Kind] = {FRAME: "whole", uid: "text", kind: "whole"}
    table = segment.read(BOXES, {**columns, **dict.fromkeys((heading, *centre, *size), "number")})
    order = np.argsort(table[FRAME], kind="stable")
    table = {name: values[order] for name, values in table.items()}
    for row, (stamp, number) in enumerate(zip(table[FRAME].tolist(), table[kind].tolist(), strict=True)):
        if stamp not in time_s:
            raise LogError(f"{path}: box {table[uid][row]} is in the frame {stamp}, which has no pose")
        if not 0 <= number < len(TYPES):
            raise LogError(f"{path}: box {table[uid][row]} has the type {number}")
    check_angles(path, "a box's heading", table[heading])
    sizes = stacked(table, size)
    flat = (sizes <= 0).any(1)
    if flat.any():
        row = int(flat.argmax())
        raise LogError(f"{path}: box {table[uid][row]} has the size {tuple(sizes[row].tolist())} m")
    stamps = table[FRAME].tolist()
    frame_times = np.array([time_s[stamp] for stamp in stamps])
    vehicle = np.array([frame_poses[stamp] for stamp in stamps]).reshape(-1, 4, 4)
    poses = vehicle @ make_pose(stacked(table, centre), quaternion_from_yaw(table[heading]))
    if not len(stamps):
        return {}
    keys = frame_times + POSE_DELAY_S if lidar is None else passing_times(lidar, poses[:, :3, 3], frame_times)
    labels = np.array([TYPES[number] for number in table[kind].tolist()], object)
    return actors_of_boxes(path, TrackedBoxes(table[uid], labels, frame_times, poses, sizes, keys))
