"""Trajectories as coloured line segments for a view: speed as colour, ticks at whole seconds, where it was recorded."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...core.geometry import BoolArray, FloatArray, box_corners
from ..sampled.clock import Clock

SLOW, FAST = np.array([0.1, 0.35, 1.0]), np.array([1.0, 0.25, 0.1])
RECORDED = np.array([0.7, 0.7, 0.7])
FASTEST_M_S = 15.0
TICK_M = 0.4
EDGES = [(0, 1), (2, 3), (4, 5), (6, 7), (0, 2), (1, 3), (4, 6), (5, 7), (0, 4), (1, 5), (2, 6), (3, 7)]
"""Of a box, by the numbers of `box_corners`."""


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
    return joined([_line(poses[there], speed_colours(poses, clock)[there]), _ticks(poses, clock, there)])


def recorded_lines(poses: FloatArray, at: int, size_m: FloatArray | None) -> TrailSegments:
    """Return a recorded trajectory (N, 4, 4) in grey, with a box of size (3,) at frame number ``at``;
    without a box for None."""
    parts = [_line(poses, np.tile(RECORDED, (len(poses), 1)))]
    if size_m is not None:
        corners = box_corners(poses[at], size_m)[np.array(EDGES).ravel()]
        parts.append(_coloured(corners, np.tile(RECORDED, (len(corners), 1))))
    return joined(parts)


def joined(parts: Sequence[TrailSegments]) -> TrailSegments:
    """Return several lines as one; no segments for none."""
    return TrailSegments(
        np.concatenate([np.zeros((0, 3)), *(part.points for part in parts)]),
        np.concatenate([np.zeros((0, 4)), *(part.colours for part in parts)]),
    )


def _coloured(points: FloatArray, rgb: FloatArray) -> TrailSegments:
    """Opaque lines of ends (2 S, 3) and colours (2 S, 3)."""
    return TrailSegments(points, np.concatenate([rgb, np.ones((len(rgb), 1))], -1))


def _line(poses: FloatArray, colours: FloatArray) -> TrailSegments:
    points = poses[:, :3, 3]
    pairs = np.stack([points[:-1], points[1:]], 1), np.stack([colours[:-1], colours[1:]], 1)
    return _coloured(pairs[0].reshape(-1, 3), pairs[1].reshape(-1, 3))


def _ticks(poses: FloatArray, clock: Clock, there: BoolArray) -> TrailSegments:
    seconds = np.arange(np.ceil(clock.times_s[0]), clock.times_s[-1])
    at = np.searchsorted(clock.times_s, seconds)
    at = at[there[at]]
    middle, side = poses[at, :3, 3], poses[at, :3, 1] * TICK_M
    return _coloured(np.stack([middle - side, middle + side], 1).reshape(-1, 3), np.ones((2 * len(at), 3)))
