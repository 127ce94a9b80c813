"""Trajectories and rollouts as coloured line segments for a view: speed as colour, ticks at whole seconds, where it was
recorded; the plan of a driver, and the recorded boxes of what a rollout has elsewhere."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ...core.geometry import BoolArray, FloatArray, box_corners
from ...core.sensors.silhouettes import BOX_EDGES
from ...core.simulation.vehicle.parameters import Vehicle
from ..sampled.clock import Clock
from ..simulation.rollouts import PlannedPath

SLOW, FAST = np.array([0.1, 0.35, 1.0]), np.array([1.0, 0.25, 0.1])
RECORDED = np.array([0.7, 0.7, 0.7, 1.0])
FASTEST_M_S = 15.0
TICK_M = 0.4
PLAN = np.array([0.1, 0.9, 0.35, 1.0])
GHOST = np.array([0.75, 0.75, 0.85, 0.8])
SUNLIGHT, SHADOW = np.array([1.0, 0.8, 0.2, 1.0]), np.array([0.0, 0.0, 0.0, 0.8])
SUN_LINE_M, SUN_DISC_M = 8.0, 0.5
"""Length of the line to the sun, and the radius of the disc at its end."""
DRIVEN = np.array([1.0, 0.75, 0.1, 1.0])
ABOVE_M = 0.15
"""Height of a drawn plan above the rear axle's, so that the road does not hide it."""
PLAN_TICK_M = 0.5
EGO_HEIGHT_M = 1.5
AXLE_HEIGHT_M = 0.35
APART_M = 0.05
"""Smallest distance of an actor from its recorded place at which its recorded box is drawn too, metres."""


@dataclass(frozen=True)
class TrailSegments:
    """Segments: ends (2 S, 3) and their linear colours (2 S, 4)."""

    points: FloatArray
    colours: FloatArray


def speed_colours(poses: FloatArray, clock: Clock) -> FloatArray:
    """Colours (N, 3) of the speeds (N,) along a trajectory."""
    speed = np.linalg.norm(np.gradient(poses[:, :3, 3], clock.times_s, axis=0), axis=1)
    share = np.clip(speed / FASTEST_M_S, 0, 1)[:, None]
    return np.asarray(SLOW * (1 - share) + FAST * share)


def own_lines(poses: FloatArray | None, there: BoolArray, clock: Clock) -> TrailSegments:
    """Return an object's trajectory (N, 4, 4) where it is present (N,), coloured by speed, with ticks at whole seconds;
    no lines for an object without any."""
    if poses is None or not there.any():
        return joined([])
    rgb = speed_colours(poses, clock)[there]
    colours = np.concatenate([rgb, np.ones((len(rgb), 1))], -1)
    path = TrailSegments(_pairs(poses[there, :3, 3]), _pairs(colours))
    return joined([path, _ticks(poses, clock, there)])


def recorded_lines(poses: FloatArray, at: int, size_m: FloatArray | None) -> TrailSegments:
    """Return a recorded trajectory (N, 4, 4) in grey, with a box of size (3,) at frame number ``at``;
    without a box for None."""
    parts = [path_lines(poses[:, :3, 3], RECORDED)]
    if size_m is not None:
        parts.append(_lines(_box(poses[at], size_m), RECORDED))
    return joined(parts)


def joined(parts: Sequence[TrailSegments]) -> TrailSegments:
    """Return several lines as one; no segments for none."""
    return TrailSegments(
        np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)]),
        np.concatenate([np.zeros((0, 4)), *(part.colours for part in parts)]),
    )


def _ticks(poses: FloatArray, clock: Clock, there: BoolArray) -> TrailSegments:
    assert len(poses) == len(clock.times_s), (poses.shape, clock.times_s.shape)
    seconds = np.arange(np.ceil(clock.times_s[0]), clock.times_s[-1])
    at = np.searchsorted(clock.times_s, seconds)
    at = at[there[at]]
    middle, side = poses[at, :3, 3], poses[at, :3, 1] * TICK_M
    return _lines(np.stack([middle - side, middle + side], 1).reshape(-1, 3), np.ones(4))


def plan_lines(plan: PlannedPath | None, height_m: float) -> TrailSegments:
    """Return a plan at a height, with a tick at each of its seconds; no lines for none."""
    if plan is None or len(plan.places) < 2:
        return joined([])
    points = np.concatenate([plan.places, np.full((len(plan.places), 1), height_m + ABOVE_M)], -1)
    parts = [_lines(_pairs(points), PLAN)]
    seconds = np.arange(np.floor(plan.times_s[0]) + 1, plan.times_s[-1] + 1e-6)
    if len(seconds):
        moments = seconds + np.array([[0.0], [0.1], [-0.1]])
        middle, ahead, behind = np.stack([np.interp(moments, plan.times_s, column) for column in points.T], -1)
        along = ahead - behind
        side = np.stack([-along[:, 1], along[:, 0], np.zeros(len(along))], -1)
        side *= PLAN_TICK_M / np.maximum(np.linalg.norm(side, axis=1, keepdims=True), 1e-6)
        parts.append(_lines(np.stack([middle - side, middle + side], 1).reshape(-1, 3), PLAN))
    return joined(parts)


def ghost_lines(apart: Iterable[tuple[FloatArray, FloatArray, FloatArray]]) -> TrailSegments:
    """Return the recorded boxes of what is elsewhere, each with a line to where it is, of poses (4, 4) recorded and
    now, and sizes (3,)."""
    parts = []
    for recorded, now, size_m in apart:
        if np.linalg.norm(recorded[:3, 3] - now[:3, 3]) < APART_M:
            continue
        parts.append(_lines(_box(recorded, size_m), GHOST))
        parts.append(_lines(np.stack([recorded[:3, 3], now[:3, 3]]), GHOST))
    return joined(parts)


def vehicle_boxes(recorded: FloatArray, now: FloatArray, vehicle: Vehicle) -> TrailSegments:
    """Return the vehicle's box where it drives, and beside it the one where it was recorded, of poses (4, 4) of its ego
    frame."""
    size = np.array([vehicle.length_m, vehicle.width_m, EGO_HEIGHT_M])
    middle = vehicle.ego_from_axle.copy()
    middle[0, 3] += vehicle.length_m / 2 - vehicle.rear_overhang_m
    middle[2, 3] += EGO_HEIGHT_M / 2 - AXLE_HEIGHT_M
    parts = [_lines(_box(now @ middle, size), DRIVEN)]
    return joined([*parts, ghost_lines([(recorded @ middle, now @ middle, size)])])


def sun_lines(pose: FloatArray, size_m: FloatArray, toward: FloatArray) -> TrailSegments:
    """Return a line from a box, its pose (4, 4) and size (3,), ``toward`` (3,) the sun, with the sun's disc at its end, and
    the line of the box's shadow on the ground under it."""
    middle, foot = pose[:3, 3], pose[:3, 3] - pose[:3, 2] * size_m[2] / 2
    end = middle + SUN_LINE_M * toward
    side = np.cross(toward, [0.0, 1.0, 0.0] if abs(toward[1]) < 0.9 else [1.0, 0.0, 0.0])
    side /= np.linalg.norm(side)
    turns = np.linspace(0, 2 * np.pi, 17)[:, None]
    disc = end + SUN_DISC_M * (np.cos(turns) * side + np.sin(turns) * np.cross(toward, side))
    shadow = foot - np.append(toward[:2], 0.0) * size_m[2] / toward[2]
    lines = np.concatenate([np.stack([middle, end]), _pairs(disc)])
    return joined([_lines(lines, SUNLIGHT), _lines(np.stack([foot, shadow]), SHADOW)])


def path_lines(positions: FloatArray, colour: FloatArray = GHOST * [1, 1, 1, 0.5]) -> TrailSegments:
    """Return a recorded path (P, 3) in a linear colour (4,)."""
    return _lines(_pairs(positions), colour)


def _box(pose: FloatArray, size_m: FloatArray) -> FloatArray:
    return box_corners(pose, size_m)[BOX_EDGES.ravel()]


def _pairs(values: FloatArray) -> FloatArray:
    """Return both ends of each piece (2 N - 2, D) of a line through N values (N, D)."""
    return np.repeat(values, 2, 0)[1:-1]


def _lines(points: FloatArray, colour: FloatArray) -> TrailSegments:
    return TrailSegments(points, np.tile(colour, (len(points), 1)))
