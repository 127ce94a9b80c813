"""Collisions with what stands: the scene's own matter inside the ego's box, above the ground."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...geometry import BoolArray, FloatArray, transform_points
from .record import Record, RecordError

Occupied = Callable[[FloatArray], BoolArray]
"""Which points (N, 3), world frame, lie in matter: (N,)."""
SPACING_M = 0.2
"""Between the points of the ego's box. What is thinner may stand between them."""
CLEARANCE_M = 0.3
"""What is lower than this above the ground is driven over: road, kerbs, noise of the ground."""
HEIGHT_M = 1.5
LEAST_POINTS = 5
"""Of the box's points in matter that make a collision; fewer are noise of the scene. (HUGSIM asks for 100
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
    spacing_m: float = SPACING_M,
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
    found = np.asarray(occupied(points))
    if found.shape != (len(points),) or found.dtype != np.bool_:
        answer = f"{found.dtype} {found.shape}"
        raise RecordError(f"occupied() must answer {len(points)} points with as many truth values, not {answer}")
    return found
