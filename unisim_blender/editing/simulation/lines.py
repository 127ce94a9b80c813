"""A rollout as coloured line segments for a view: the driver's plan, and where the recording has what was driven elsewhere."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ...core.geometry import FloatArray, box_corners
from ...core.simulation.vehicle.parameters import Vehicle
from ..motion.trails import EDGES, TrailSegments, joined
from .rollouts import Planned

PLAN = np.array([0.1, 0.9, 0.35, 1.0])
GHOST = np.array([0.75, 0.75, 0.85, 0.8])
DRIVEN = np.array([1.0, 0.75, 0.1, 1.0])
ABOVE_M = 0.15
"""A plan is drawn so far above the rear axle's height, so that the road does not hide it."""
TICK_M = 0.5
EGO_HEIGHT_M = 1.5
AXLE_HEIGHT_M = 0.35
APART_M = 0.05
"""Smallest distance of an actor from its recorded place at which its recorded box is drawn too, metres."""


def plan_lines(plan: Planned | None, height_m: float) -> TrailSegments:
    """Return a plan at a height, with a tick at each of its seconds; no lines for none."""
    if plan is None or len(plan.places) < 2:
        return joined([])
    points = np.concatenate([plan.places, np.full((len(plan.places), 1), height_m + ABOVE_M)], -1)
    parts = [_lines(_pairs(points), PLAN)]
    seconds = np.arange(np.floor(plan.times_s[0]) + 1, plan.times_s[-1] + 1e-6)
    if len(seconds):
        middle = np.stack([np.interp(seconds, plan.times_s, points[:, axis]) for axis in range(3)], -1)
        ahead = np.stack([np.interp(seconds + 0.1, plan.times_s, points[:, axis]) for axis in range(3)], -1)
        behind = np.stack([np.interp(seconds - 0.1, plan.times_s, points[:, axis]) for axis in range(3)], -1)
        along = ahead - behind
        side = np.stack([-along[:, 1], along[:, 0], np.zeros(len(along))], -1)
        side *= TICK_M / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-6)
        parts.append(_lines(np.stack([middle - side, middle + side], 1).reshape(-1, 3), PLAN))
    return joined(parts)


def ghost_lines(apart: Iterable[tuple[FloatArray, FloatArray, FloatArray]]) -> TrailSegments:
    """Return the recorded boxes of what is elsewhere, each with a line to where it is, of poses (4, 4) recorded and now, and
    sizes (3,)."""
    parts = []
    for recorded, now, size_m in apart:
        if np.linalg.norm(recorded[:3, 3] - now[:3, 3]) < APART_M:
            continue
        parts.append(_lines(_box(recorded, size_m), GHOST))
        parts.append(_lines(np.stack([recorded[:3, 3], now[:3, 3]]), GHOST))
    return joined(parts)


def vehicle_boxes(recorded: FloatArray, now: FloatArray, vehicle: Vehicle) -> TrailSegments:
    """Return the vehicle's box where it drives, and beside it the one where it was recorded, of poses (4, 4) of its ego frame."""
    size = np.array([vehicle.length_m, vehicle.width_m, EGO_HEIGHT_M])
    middle = vehicle.ego_from_axle.copy()
    middle[0, 3] += vehicle.length_m / 2 - vehicle.rear_overhang_m
    middle[2, 3] += EGO_HEIGHT_M / 2 - AXLE_HEIGHT_M
    parts = [_lines(_box(now @ middle, size), DRIVEN)]
    return joined([*parts, ghost_lines([(recorded @ middle, now @ middle, size)])])


def path_lines(positions: FloatArray) -> TrailSegments:
    """Return a recorded path (P, 3)."""
    return _lines(_pairs(positions), GHOST * [1, 1, 1, 0.5])


def _box(pose: FloatArray, size_m: FloatArray) -> FloatArray:
    return box_corners(pose, size_m)[np.array(EDGES).ravel()]


def _pairs(points: FloatArray) -> FloatArray:
    return np.stack([points[:-1], points[1:]], 1).reshape(-1, 3)


def _lines(points: FloatArray, colour: FloatArray) -> TrailSegments:
    return TrailSegments(points, np.tile(colour, (len(points), 1)))
