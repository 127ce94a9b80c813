"""Whether the ego left the road or drove into the static scene.

The road is known by labels where there are any, else by a corridor around the recorded paths. A collision with the static
scene is matter of the scene inside the ego's box, above the ground.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...geometry import BoolArray, FloatArray, transform_points
from ...world.polyline import Polyline
from ..footprints import directions, footprint_corners
from .record import Record, RecordError

RoadTest = Callable[[FloatArray], BoolArray]
"""Which points (N, 2), world frame, are on the road: (N,). What is not known counts as the caller decides."""
CORRIDOR_M = 7.0
"""Two lanes wide: around its own path a car 2 m wide may be 2.5 m aside."""
PIECE = 32
"""Points of a path whose common bounds are compared with a point first."""


@dataclass(frozen=True)
class OffRoad:
    """``off_road``: a corner of the ego's box left the road at some step, first at ``first_s``; ``steps_share``: at
    what share of the steps one was off. ``method``: "road_labels" or "recorded_corridor"; of the latter,
    ``corridor_width_m``, and ``farthest_m``: how far outside of it a corner was at most."""

    off_road: bool
    method: str
    first_s: float | None
    steps_share: float
    corridor_width_m: float | None = None
    farthest_m: float | None = None


def off_road(record: Record, on_road: RoadTest | None = None, corridor_width_m: float = CORRIDOR_M) -> OffRoad:
    """Whether a corner of the ego's box was off the road at a step (as NAVSIM's drivable area compliance asks of its
    map).

    With ``on_road``, road is where that says so. Without, it is what lies within half of ``corridor_width_m`` of the
    path of the log's ego, from bumper to bumper, or of one of `Record.recorded_paths`: a stand-in that knows no more than
    where somebody drove. Raises `RecordError` where ``on_road`` answers anything but one truth value for each point.
    """
    corners = footprint_corners(record.ego_boxes).reshape(-1, 2)
    if on_road is not None:
        inside = np.asarray(on_road(corners))
        if inside.shape != (len(corners),) or inside.dtype != np.bool_:
            answer = f"{inside.dtype} {inside.shape}"
            raise RecordError(f"on_road() must answer {len(corners)} points with as many truth values, not {answer}")
        return _result(record, inside, "road_labels")
    if not (np.isfinite(corridor_width_m) and corridor_width_m > 0):
        raise RecordError(f"the width of the corridor is {corridor_width_m} m, not a positive number")
    excess = _beyond_corridor(record, corners, corridor_width_m)
    result = _result(record, excess == 0, "recorded_corridor")
    return OffRoad(
        result.off_road, result.method, result.first_s, result.steps_share, corridor_width_m, float(excess.max())
    )


def in_corridor(record: Record, points: FloatArray) -> BoolArray:
    """Return which points (N, 2) are in the corridor, `CORRIDOR_M` wide, of the recorded paths."""
    return _beyond_corridor(record, points, CORRIDOR_M) == 0


def _beyond_corridor(record: Record, points: FloatArray, width_m: float) -> FloatArray:
    paths = (_bumper_to_bumper(record), *record.recorded_paths)
    return np.maximum(corridor_distance(points, paths, width_m / 2) - width_m / 2, 0.0)


def _bumper_to_bumper(record: Record) -> FloatArray:
    """Return the recorded path (K, 2) of the ego, from where its rear was first to where its front was last: a vehicle
    that repeats the recorded drive stays in the corridor."""
    ego, box, axle = record.recorded_ego, record.ego_boxes[0], record.ego_axle[0]
    middle = float((box[:2] - axle[:2]) @ directions(axle[2]))
    first, last = ego.at(ego.times_s[[0, -1]])
    rear = first[:2, 3] + min(middle - box[2] / 2, 0.0) * first[:2, 0]
    front = last[:2, 3] + max(middle + box[2] / 2, 0.0) * last[:2, 0]
    return np.concatenate([rear[None], ego.positions[:, :2], front[None]])


def corridor_distance(points: FloatArray, paths: tuple[FloatArray, ...], near_m: float) -> FloatArray:
    """Distances (N,) of points (N, 2) to the nearest of paths (K, 2), at least one. A point that is found to be
    within ``near_m`` of one is not compared with further ones."""
    best = np.full(len(points), np.inf)
    for piece in (path[start : start + PIECE + 1] for path in paths for start in range(0, len(path), PIECE)):
        left = np.flatnonzero(best > near_m)
        if not len(left):
            break
        beyond = np.maximum(np.maximum(piece.min(0) - points[left], points[left] - piece.max(0)), 0.0)
        left = left[np.hypot(beyond[:, 0], beyond[:, 1]) < best[left]]
        best[left] = np.minimum(best[left], Polyline.through(piece).distances(points[left]))
    return best


def _result(record: Record, inside: BoolArray, method: str) -> OffRoad:
    off = ~inside.reshape(-1, 4).all(1)
    first = float(record.times_s[off.argmax()]) if off.any() else None
    return OffRoad(bool(off.any()), method, first, float(off.mean()))


Occupied = Callable[[FloatArray], BoolArray]
"""Which points (N, 3), world frame, lie in matter: (N,)."""
BOX_SPACING_M = 0.2
"""Between the points of the ego's box. What is thinner may stand between them."""
CLEARANCE_M = 0.3
"""Height above the ground below which matter is driven over, metres: road, kerbs, noise of the ground."""
HEIGHT_M = 1.5
LEAST_POINTS = 5
"""Least number of the box's points in matter that make a collision; fewer are noise of the scene. (HUGSIM asks for 100
Gaussians.)"""


@dataclass(frozen=True)
class StaticCollision:
    """``first_s``: the first step at which the ego's box is in matter; None where it never is. ``steps``: at how many
    it is, and ``most_points`` at once. ``at_start``: it was where the rollout began. ``collided`` is None, with a
    ``reason``, where that cannot be said."""

    collided: bool | None = None
    first_s: float | None = None
    steps: int | None = None
    most_points: int | None = None
    at_start: bool | None = None
    reason: str | None = None


def static_collision(
    record: Record,
    occupied: Occupied | None,
    *,
    height_m: float = HEIGHT_M,
    clearance_m: float = CLEARANCE_M,
    spacing_m: float = BOX_SPACING_M,
    least_points: int = LEAST_POINTS,
) -> StaticCollision:
    """Whether the ego drove into the static scene, at the steps of the record.

    The ego's box stands on the ground by `Record.ego_poses`, its length and width are the footprint's. Raises
    `RecordError` where ``occupied`` answers anything but one truth value for each point.
    """
    if occupied is None:
        return StaticCollision(reason="the scene's occupancy is not known")
    if record.ego_poses is None:
        return StaticCollision(reason="the record has no heights of the ego")
    counts = np.zeros(len(record.times_us), np.int64)
    for step, pose in enumerate(record.ego_poses):
        points = transform_points(pose, _points(record, step, height_m, clearance_m, spacing_m))
        counts[step] = _answer(occupied, points).sum()
    hit = np.flatnonzero(counts >= least_points)
    return StaticCollision(
        collided=bool(len(hit)),
        first_s=float(record.times_s[hit[0]]) if len(hit) else None,
        steps=len(hit),
        most_points=int(counts.max()),
        at_start=bool(len(hit) and hit[0] == 0),
    )


def _points(record: Record, step: int, height_m: float, clearance_m: float, spacing_m: float) -> FloatArray:
    """Points (N, 3) that fill the ego's box, seen from the ground beneath its rear axle; the box's edges are among
    them."""
    x, y, length, width, _ = record.ego_boxes[step]
    axle_x, axle_y, heading = record.ego_axle[step]
    ahead = (x - axle_x) * np.cos(heading) + (y - axle_y) * np.sin(heading)
    aside = (y - axle_y) * np.cos(heading) - (x - axle_x) * np.sin(heading)
    ends = ((ahead - length / 2, ahead + length / 2), (aside - width / 2, aside + width / 2), (clearance_m, height_m))
    grids = [np.linspace(low, high, int(np.ceil((high - low) / spacing_m)) + 1) for low, high in ends]
    return np.stack(np.meshgrid(*grids, indexing="ij"), -1).reshape(-1, 3)


def _answer(occupied: Occupied, points: FloatArray) -> BoolArray:
    inside = np.asarray(occupied(points))
    if inside.shape != (len(points),) or inside.dtype != np.bool_:
        answer = f"{inside.dtype} {inside.shape}"
        raise RecordError(f"occupied() must answer {len(points)} points with as many truth values, not {answer}")
    return inside
