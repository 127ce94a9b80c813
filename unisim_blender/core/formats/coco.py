"""A run's images with boxes in COCO's format: one JSON file of annotations."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from ..files import partial_file
from ..geometry import make_pose
from ..json_file import Node
from ..sensors.silhouettes import box_bounds
from .common.messages import SECOND_NS, ImageMessage, Run, RunFormat

LEAST_PX = 1.0
"""Boxes of which less is in the image, across or down, are left out."""


def write_coco(run: Run, path: Path) -> None:
    """Write the annotations of a run's images, whose paths are relative to the run's folder; images are not read, and one moment
    is in memory at a time.

    An annotation is the rectangle about an actor's box at the image's time, within the image, also where something hides it.
    """
    labels = sorted({actor.label for actor in run.drive.actors.values()})
    categories = {label: number for number, label in enumerate(labels, 1)}
    with partial_file(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write('{\n"info": ' + json.dumps({"description": run.drive.name, "shift_s": run.shift_ns / SECOND_NS}))
        _write_list(file, "licenses", iter(()))
        _write_list(file, "categories", ({"id": number, "name": name} for name, number in categories.items()))
        _write_list(file, "images", _images(run))
        _write_list(file, "annotations", _annotations(run, categories))
        file.write("\n}\n")


def _write_list(file: IO[str], name: str, members: Iterator[dict[str, Any]]) -> None:
    """Write a list's members as they come."""
    file.write(f',\n"{name}": [')
    for number, member in enumerate(members):
        file.write(("," if number else "") + "\n" + json.dumps(member, allow_nan=False))
    file.write("]")


def _images(run: Run) -> Iterator[dict[str, Any]]:
    for number, (image, _) in enumerate(run.images(), 1):
        yield {
            "id": number,
            "file_name": run.name_of(image),
            "width": image.model.width,
            "height": image.model.height,
            "camera": image.sensor_id,
            "time_s": image.time_ns / SECOND_NS,
        }


def _annotations(run: Run, categories: dict[str, int]) -> Iterator[dict[str, Any]]:
    count = 0
    for number, (image, boxes) in enumerate(run.images(), 1):
        for uid, pose in boxes.members():
            if uid not in run.drive.actors:
                pose.fail("is of no actor of the drive")
            actor = run.drive.actors[uid]
            rectangle = _rectangle(image, pose, actor.size_m)
            if rectangle is None:
                continue
            count += 1
            yield {
                "id": count,
                "image_id": number,
                "category_id": categories[actor.label],
                "bbox": rectangle,
                "area": rectangle[2] * rectangle[3],
                "iscrowd": 0,
                "actor": uid,
            }


def _rectangle(image: ImageMessage, pose: Node, size_m: Any) -> list[float] | None:
    """x, y, width, height of a box in the image, in pixels from its upper left corner; None where next to nothing of it is."""
    position, quaternion = pose.key("position").array(3), pose.key("quaternion_wxyz").array(4)
    bounds = box_bounds(image.model, make_pose(position, quaternion), size_m)
    if bounds is None:
        return None
    left, right = np.clip((bounds.left, bounds.right), 0.0, image.model.width).tolist()
    top, bottom = np.clip((bounds.top, bounds.bottom), 0.0, image.model.height).tolist()
    if right - left < LEAST_PX or bottom - top < LEAST_PX:
        return None
    return [left, top, right - left, bottom - top]


COCO = RunFormat("coco", "coco.json", (), ("png", "labels"), write_coco)
