"""KITTI's boxes: `tracklet_labels.xml` of a raw drive, and a tracking sequence's labels."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ...data.values import check_angles
from ...errors import LogError, in_a_line, short
from ...geometry import FloatArray, invert_pose, make_pose, quaternion_from_yaw
from .files import BoxRecord, numbered_lines, numbers, read_text, rows_of_numbers

NO_OBJECT = "DontCare"
"""Tracking labels mark parts of an image so that hold objects too far away to be annotated."""
LABEL_WORDS = 17
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
        BoxRecord(*one, pose, size)
        for one, pose, size in zip(named, invert_pose(camera0_from_lidar) @ poses, sizes, strict=True)
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
