"""KITTI's boxes: `tracklet_labels.xml` of a raw drive, and a tracking sequence's labels."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from ...errors import LogError, in_a_line, short
from ...geometry import FloatArray, invert_pose, make_pose, quaternion_from_yaw
from .files import BoxRecord, numbered_lines, numbers, read_text

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
        poses = item.find("poses")
        for step, pose in enumerate([] if poses is None else poses.findall("item")):
            tx, ty, tz, yaw = (_number(path, pose, f"{where}, pose {step}", key) for key in ("tx", "ty", "tz", "rz"))
            centre = np.array([tx, ty, tz + size[2] / 2])
            lidar_from_box = make_pose(centre, quaternion_from_yaw(yaw))
            boxes.append(BoxRecord(f"{label.lower()}-{index:04d}", label, first + step, lidar_from_box, size))
    return boxes


def read_labels(path: Path, camera0_from_lidar: FloatArray) -> list[BoxRecord]:
    """Return the boxes of a tracking sequence: in the first rectified camera's frame, by the centre of their bottom, y down.

    Raises `LogError`.
    """
    lidar_from_camera0 = invert_pose(camera0_from_lidar)
    boxes: list[BoxRecord] = []
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
        values = numbers(path, where, words[10:LABEL_WORDS])
        height, width, length, x, y, z, turned = values.tolist()
        size = np.array([length, width, height])
        _check_size(path, where, size)
        uid = f"{words[2].lower()}-{track:04d}"
        if frame < 0 or (uid, frame) in there:
            raise LogError(f"{path}: {where} gives {uid} twice" if frame >= 0 else f"{path}: {where} is frame {frame}")
        there.add((uid, frame))
        pose = np.eye(4)
        sine, cosine = np.sin(turned), np.cos(turned)
        about_y = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
        pose[:3, :3] = about_y @ CAMERA_FROM_UPRIGHT
        pose[:3, 3] = x, y - height / 2, z
        boxes.append(BoxRecord(uid, words[2], frame, lidar_from_camera0 @ pose, size))
    return boxes


def _number(path: Path, node: ElementTree.Element, where: str, key: str) -> float:
    text = node.findtext(key)
    if text is None:
        raise LogError(f"{path}: {where} has no {key}")
    return float(numbers(path, f"{where}: {key}", [text])[0])


def _check_size(path: Path, where: str, size_m: FloatArray) -> None:
    if not ((size_m > 0) & (size_m < 1e3)).all():
        raise LogError(f"{path}: {where} has the size {short(tuple(size_m.tolist()))} m")
