"""KITTI's tracking labels, 17 columns a box: what the image shows of it, how much is cut off and hidden, and where it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray, intersect_boxes, invert_pose, points_in_box, transform_points
from ...sensors.silhouettes import box_bounds
from ...world.drive import CameraModel

LEAST_PX = 1.0
"""Boxes of which less is in the image, across or down, are left out."""
LATTICE = 9
"""Points along a box's edges by which its share in the image is told."""
CUT_SHARES = (0.02, 0.5)
HIDDEN_SHARES = (0.1, 0.5)
"""Above the first of these shares a box is partly cut off or hidden, above the second largely."""
INNER = 0.8
"""Beams count that meet this share of a box: those along its edges end on the ground beside it, too."""
BEFORE_M = 0.3
"""A beam that ends this far before a box is stopped by something else."""
UNKNOWN = 3


@dataclass(frozen=True)
class Seen:
    """A box in an image: left, top, right, bottom in pixels, the first one's centre at 0, within the image; and the level of its
    truncation: 0 none, 1 partly, 2 largely."""

    bounds: tuple[float, float, float, float]
    truncated: int


def seen_in(model: CameraModel, camera_from_box: FloatArray, size_m: FloatArray) -> Seen | None:
    """Return what an image shows of a box, whatever stands before it; None where that is less than a pixel across or down."""
    found = box_bounds(model, camera_from_box, size_m)
    if found is None:
        return None
    left, right = np.clip((found.left - 0.5, found.right - 0.5), 0.0, model.width - 1.0).tolist()
    top, bottom = np.clip((found.top - 0.5, found.bottom - 0.5), 0.0, model.height - 1.0).tolist()
    if right - left < LEAST_PX or bottom - top < LEAST_PX:
        return None
    part = np.linspace(-0.5, 0.5, LATTICE)
    lattice = np.stack(np.meshgrid(part, part, part, indexing="ij"), -1).reshape(-1, 3) * np.asarray(size_m)
    u, v, valid = model.project(transform_points(camera_from_box, lattice))
    inside = valid & (u >= 0) & (u <= model.width) & (v >= 0) & (v <= model.height)
    if not inside.any():
        return None
    return Seen((left, top, right, bottom), _level(1 - float(inside.mean()), CUT_SHARES))


def hidden_levels(
    points: FloatArray, lidar_from_box: FloatArray, size_m: FloatArray
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return of boxes (A, 4, 4), (A, 3), and a sweep's points (N, 3) in the LiDAR's frame: the levels of occlusion (A,), 0 none,
    1 partly, 2 largely, 3 where no beam tells; and whether a return lies in each.

    What hides a box is what stops beams that would have met it.
    """
    distance = np.linalg.norm(points, axis=1)
    rays = points / np.maximum(distance, 1e-9)[:, None]
    levels = np.full(len(size_m), UNKNOWN)
    held = np.zeros(len(size_m), np.bool_)
    for at, (pose, size) in enumerate(zip(lidar_from_box, size_m, strict=True)):
        away, radius = float(np.linalg.norm(pose[:3, 3])), float(np.linalg.norm(size)) / 2
        near = np.arange(len(points))
        if away > radius:  # else the sensor may stand in the box
            near = np.flatnonzero(rays @ pose[:3, 3] / away >= np.sqrt(1 - (radius / away) ** 2))
        held[at] = points_in_box(points[near], pose, size).any()
        if not len(near):
            continue
        # the inner box and the whole one
        sizes, places = np.stack([INNER * size, size]), np.broadcast_to(invert_pose(pose), (2, 4, 4))
        enter, leave = intersect_boxes(np.zeros((len(near), 3)), rays[near], places, sizes)
        met = (enter[:, 0] <= leave[:, 0]) & (leave[:, 0] > 0)
        if not met.any():
            continue
        stopped = float((distance[near][met] < enter[met, 1] - BEFORE_M).mean())
        levels[at] = _level(stopped, HIDDEN_SHARES)
    return levels, held


def label_line(
    frame: int, track: int, label: str, seen: Seen, occluded: int, camera0_from_box: FloatArray, size_m: FloatArray
) -> str:
    """Return a box's line: the heading alone is kept of how it is turned, and its place is the centre of its bottom, y down."""
    length, width, height = np.asarray(size_m).tolist()
    x, y, z = (camera0_from_box[:3, 3] + [0, height / 2, 0]).tolist()
    turned = float(np.arctan2(-camera0_from_box[2, 0], camera0_from_box[0, 0]))
    alpha = float(np.angle(np.exp(1j * (turned - np.arctan2(x, z)))))
    numbers = (alpha, *seen.bounds, height, width, length, x, y, z, turned)
    return f"{frame} {track} {label} {seen.truncated} {occluded} {' '.join(f'{value:.6f}' for value in numbers)}\n"


def ignored_line(frame: int, seen: Seen) -> str:
    """Return the line of a part of the image that holds something that no beam met."""
    bounds = " ".join(f"{value:.6f}" for value in seen.bounds)
    return f"{frame} -1 DontCare -1 -1 -10 {bounds} -1000 -1000 -1000 -10 -1 -1 -1\n"


def _level(share: float, limits: tuple[float, float]) -> int:
    return int(share > limits[0]) + int(share > limits[1])
