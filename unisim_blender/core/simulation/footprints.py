"""Turned boxes in the plane: which overlap, and when boxes that move straight on meet.

A box is (..., 5): x, y, length, width (m) and heading (rad), or a `Footprint`. All tests are by separating axes (Gottschalk et
al., "OBBTree", 1996): two boxes overlap where their projections do, on each of the four axes of their sides.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..geometry import BoolArray, FloatArray
from .states import Footprint, FootprintArrays

TOUCH_M = 1e-9
"""Boxes that are this near touch, and boxes that touch overlap: rounding does not decide."""
LEAST_RATE_M_S = 1e-12
"""Speed along an axis below which a box stands still there: in a quarter of an hour it does not get `TOUCH_M` far."""


def overlap(a: FloatArray, b: FloatArray, slack_m: float = TOUCH_M) -> BoolArray:
    """Whether boxes (..., 5) overlap or are at most about ``slack_m`` apart: (...)."""
    offset, reach, _ = _separation(a, b)
    return np.asarray((np.abs(offset) <= reach + slack_m).all(-1))


def distances(a: FloatArray, b: FloatArray) -> FloatArray:
    """Distances (...) between boxes (..., 5), metres, 0 where they overlap. That of boxes apart is a corner's from the other
    box."""
    least = np.full(np.broadcast_shapes(a.shape, b.shape)[:-1], np.inf)
    for box, other in ((a, b), (b, a)):
        offset = footprint_corners(other) - box[..., None, :2]
        along = directions(box[..., 4])[..., None, :]
        across = np.stack([-along[..., 1], along[..., 0]], -1)
        beyond = [
            np.maximum(np.abs((offset * axis).sum(-1)) - box[..., 2 + index, None] / 2, 0.0)
            for index, axis in enumerate((along, across))
        ]
        least = np.minimum(least, np.hypot(*beyond).min(-1))
    return np.where(overlap(a, b), 0.0, least)


def meeting_times(a: FloatArray, b: FloatArray, velocity: FloatArray) -> tuple[FloatArray, FloatArray]:
    """When boxes begin and end to overlap, seconds from now: two (...); inf and -inf where they never do.

    a, b (..., 5); ``velocity`` (..., 2), m/s: of ``b`` seen from ``a``. Headings stay. The times are exact: along
    each axis the boxes overlap for one interval of time, and they overlap while they do along all four. A beginning
    that is negative is in the past.
    """
    offset, reach, axes = _separation(a, b)
    reach = reach + TOUCH_M
    rate = (axes * velocity[..., None, :]).sum(-1)
    moves = np.abs(rate) >= LEAST_RATE_M_S
    safe = np.where(moves, rate, 1.0)
    first, second = (-reach - offset) / safe, (reach - offset) / safe
    always = np.abs(offset) <= reach
    begin = np.where(moves, np.minimum(first, second), np.where(always, -np.inf, np.inf)).max(-1)
    end = np.where(moves, np.maximum(first, second), np.where(always, np.inf, -np.inf)).min(-1)
    meets = begin <= end
    return np.where(meets, begin, np.inf), np.where(meets, end, -np.inf)


def radii(boxes: FloatArray) -> FloatArray:
    """Radii (...) of the circles around boxes (..., 5)."""
    return np.hypot(boxes[..., 2], boxes[..., 3]) / 2


def between(before: FloatArray, after: FloatArray, fraction: FloatArray | float) -> FloatArray:
    """Boxes (..., 5) between one and another: positions are linear, headings take the shorter arc, the size is
    the first one's. ``fraction`` (...) is in [0, 1]."""
    fraction = np.asarray(fraction)
    out = np.array(np.broadcast_arrays(before, after)[0], np.float64)
    out[..., :2] += fraction[..., None] * (after[..., :2] - before[..., :2])
    out[..., 4] += fraction * shorter_arc(after[..., 4] - before[..., 4])
    return out


def shorter_arc(angle_rad: FloatArray) -> FloatArray:
    """The same turn (...) within half a turn to either side."""
    return np.asarray((angle_rad + np.pi) % (2 * np.pi) - np.pi)


def bumper(boxes: FloatArray, side: int) -> FloatArray:
    """The front (``side`` 1) or rear (-1) edges of boxes (..., 5), as boxes without a length."""
    out = np.array(boxes, np.float64)
    out[..., 0] += side * np.cos(boxes[..., 4]) * boxes[..., 2] / 2
    out[..., 1] += side * np.sin(boxes[..., 4]) * boxes[..., 2] / 2
    out[..., 2] = 0.0
    return out


def directions(headings_rad: FloatArray) -> FloatArray:
    """Unit vectors (..., 2) of headings (...)."""
    return np.stack([np.cos(headings_rad), np.sin(headings_rad)], -1)


def footprint_corners(boxes: FloatArray) -> FloatArray:
    """Corners (..., 4, 2) of boxes (..., 5): front left, rear left, rear right, front right."""
    along = directions(boxes[..., 4])
    across = np.stack([-along[..., 1], along[..., 0]], -1)
    along, across = along * boxes[..., 2:3] / 2, across * boxes[..., 3:4] / 2
    corners = np.stack([along + across, across - along, -along - across, along - across], -2)
    return np.asarray(boxes[..., None, :2] + corners)


def _separation(a: FloatArray, b: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Along the four axes of two boxes' sides: how far the centres are apart (..., 4), how far apart they are when
    the boxes touch (..., 4), and the axes (..., 4, 2)."""
    a, b = np.broadcast_arrays(a, b)
    along_a, along_b = directions(a[..., 4]), directions(b[..., 4])
    turned = [np.stack([-along[..., 1], along[..., 0]], -1) for along in (along_a, along_b)]
    axes = np.stack([along_a, turned[0], along_b, turned[1]], -2)
    offset = (axes * (b[..., :2] - a[..., :2])[..., None, :]).sum(-1)
    angle = b[..., 4] - a[..., 4]
    cosine, sine = np.abs(np.cos(angle)), np.abs(np.sin(angle))
    half_a, half_b = a[..., 2:4] / 2, b[..., 2:4] / 2
    reach = np.stack(
        [
            half_a[..., 0] + half_b[..., 0] * cosine + half_b[..., 1] * sine,
            half_a[..., 1] + half_b[..., 0] * sine + half_b[..., 1] * cosine,
            half_b[..., 0] + half_a[..., 0] * cosine + half_a[..., 1] * sine,
            half_b[..., 1] + half_a[..., 0] * sine + half_a[..., 1] * cosine,
        ],
        -1,
    )
    return offset, reach, axes


SUBSTEPS = 10
"""Parts of a step with a heading each. NeuroNCAP checks as many moments between two steps."""


def first_contacts(times_s: FloatArray, ego: FloatArray, others: FloatArray, present: BoolArray) -> FloatArray:
    """When each other box first overlaps the ego's, seconds; inf where it never does: (A,).

    times_s (T,) increasing, ego (T, 5), others (T, A, 5), present (T, A). At the steps boxes are as they are. Between
    two steps positions are linear, and headings are constant over each tenth: nothing is jumped over, and the times
    are exact where nothing turns. Where something turns at w rad/s in steps of d seconds, a corner at r metres from
    the centre is off by w d r / 20 at most: 1 cm for a car at 1 rad/s in steps of 0.1 s.
    """
    out = np.full(others.shape[1], np.inf)
    reach = radii(ego)[:, None] + radii(others)
    apart = np.hypot(*np.moveaxis(others[..., :2] - ego[:, None, :2], -1, 0))
    near = present & (apart <= reach + 1e-6)
    steps, actors = np.nonzero(near)
    met = overlap(ego[steps], others[steps, actors])
    np.minimum.at(out, actors[met], times_s[steps[met]])
    if len(times_s) == 1:
        return out

    moved_ego = np.linalg.norm(np.diff(ego[:, :2], axis=0), axis=-1)
    moved = np.linalg.norm(np.diff(others[..., :2], axis=0), axis=-1)
    near = present[:-1] & present[1:] & (apart[:-1] <= reach[:-1] + moved_ego[:, None] + moved + 1e-6)
    near &= times_s[:-1, None] < out  # what has met already need not be looked at again
    steps, actors = np.nonzero(near)
    duration = times_s[steps + 1] - times_s[steps]
    begins = (ego[steps], others[steps, actors])
    ends = (ego[steps + 1], others[steps + 1, actors])
    velocity = ((ends[1] - begins[1])[:, :2] - (ends[0] - begins[0])[:, :2]) / duration[:, None]
    for part in range(SUBSTEPS):
        now = [between(begin, end, part / SUBSTEPS) for begin, end in zip(begins, ends, strict=True)]
        for box, begin, end in zip(now, begins, ends, strict=True):
            box[:, 4] = begin[:, 4] + (part + 0.5) / SUBSTEPS * shorter_arc(end[:, 4] - begin[:, 4])
        begin_s, end_s = meeting_times(now[0], now[1], velocity)
        met = (begin_s <= duration / SUBSTEPS) & (end_s >= 0)
        at_s = times_s[steps] + part / SUBSTEPS * duration + np.maximum(begin_s, 0.0)
        np.minimum.at(out, actors[met], at_s[met])
    return out


def velocities(headings_rad: FloatArray, speeds_m_s: FloatArray) -> FloatArray:
    """Velocities (..., 2) of what moves along its heading."""
    return directions(headings_rad) * speeds_m_s[..., None]


ROUNDING_M = 1e-3
"""Circles that are so far apart touch."""


def time_to_overlap(a: Footprint, b: Footprint, horizon_s: float) -> float | None:
    """Return when two boxes first overlap if each keeps its velocity, along its heading, and its heading; None where they do
    not within ``horizon_s``."""
    # as `_first_overlaps`: for two boxes numbers are faster than arrays
    dx, dy = b.x_m - a.x_m, b.y_m - a.y_m
    a_cos, a_sin, b_cos, b_sin = (of(box.heading_rad) for box in (a, b) for of in (math.cos, math.sin))
    vx, vy = b.speed_m_s * b_cos - a.speed_m_s * a_cos, b.speed_m_s * b_sin - a.speed_m_s * a_sin
    c, s = abs(a_cos * b_cos + a_sin * b_sin), abs(a_cos * b_sin - a_sin * b_cos)
    length, width, b_length, b_width = a.length_m / 2, a.width_m / 2, b.length_m / 2, b.width_m / 2
    first, last = 0.0, math.inf
    for x, y, half in (
        (a_cos, a_sin, length + b_length * c + b_width * s),
        (-a_sin, a_cos, width + b_length * s + b_width * c),
        (b_cos, b_sin, b_length + length * c + width * s),
        (-b_sin, b_cos, b_width + length * s + width * c),
    ):
        apart, speed = dx * x + dy * y, vx * x + vy * y
        if abs(speed) < LEAST_RATE_M_S:
            if abs(apart) > half:
                return None
            continue
        enters, leaves = (-half - apart) / speed, (half - apart) / speed
        if speed < 0:
            enters, leaves = leaves, enters
        first, last = max(first, enters), min(last, leaves)
    return first if first <= min(last, horizon_s) else None


def times_to_overlap(a: FootprintArrays, b: FootprintArrays, horizon_s: float = math.inf) -> FloatArray:
    """Return when boxes (N,) first overlap others (M,) if each keeps its velocity, along its heading, and its heading: seconds
    (N, M), inf where they never do; those later than ``horizon_s`` may be inf, too.

    Exact: on each axis that a side of either is normal to, two boxes overlap during one interval; they overlap where all four
    do (separating axes).
    """
    every = slice(None), None
    if math.isinf(horizon_s):
        return _first_overlaps(a, b, every, slice(None))
    near = _may_meet(a, b, horizon_s)
    times = np.full(near.shape, math.inf)
    own, other = np.nonzero(near)
    times[own, other] = _first_overlaps(a, b, own, other)
    return times


def _may_meet(a: FootprintArrays, b: FootprintArrays, horizon_s: float) -> BoolArray:
    """Return whether the circles about boxes (N,) and others (M,) touch within ``horizon_s``: (N, M)."""
    dx, dy = b.x_m - a.x_m[:, None], b.y_m - a.y_m[:, None]
    vx = b.speed_m_s * b.cos - (a.speed_m_s * a.cos)[:, None]
    vy = b.speed_m_s * b.sin - (a.speed_m_s * a.sin)[:, None]
    nearest_s = np.clip(-(dx * vx + dy * vy) / np.maximum(vx * vx + vy * vy, LEAST_RATE_M_S), 0.0, horizon_s)
    dx += vx * nearest_s
    dy += vy * nearest_s
    return np.asarray(dx * dx + dy * dy <= (a.radius_m[:, None] + b.radius_m + ROUNDING_M) ** 2)


def _first_overlaps(a: FootprintArrays, b: FootprintArrays, own: Any, other: Any) -> FloatArray:
    """Return when boxes ``own`` of a first overlap ``other`` ones of b, indices of pairs: seconds, inf where they never do."""
    dx, dy = b.x_m[other] - a.x_m[own], b.y_m[other] - a.y_m[own]
    cos, sin, b_cos, b_sin = a.cos[own], a.sin[own], b.cos[other], b.sin[other]
    vx = b.speed_m_s[other] * b_cos - a.speed_m_s[own] * cos
    vy = b.speed_m_s[other] * b_sin - a.speed_m_s[own] * sin
    c, s = np.abs(cos * b_cos + sin * b_sin), np.abs(cos * b_sin - sin * b_cos)
    length, width = a.half_length_m[own], a.half_width_m[own]
    b_length, b_width = b.half_length_m[other], b.half_width_m[other]
    first, last = np.zeros(dx.shape), np.full(dx.shape, math.inf)
    for x, y, half in (
        (cos, sin, length + b_length * c + b_width * s),
        (-sin, cos, width + b_length * s + b_width * c),
        (b_cos, b_sin, b_length + length * c + width * s),
        (-b_sin, b_cos, b_width + length * s + width * c),
    ):
        apart, speed = dx * x + dy * y, vx * x + vy * y
        still = np.abs(speed) < LEAST_RATE_M_S
        safe = np.where(still, 1.0, speed)
        enters, leaves = (-half - apart) / safe, (half - apart) / safe
        beside = np.abs(apart) > half
        begins = np.where(still, np.where(beside, math.inf, 0.0), np.minimum(enters, leaves))
        ends = np.where(still, math.inf, np.maximum(enters, leaves))
        np.maximum(first, begins, out=first)
        np.minimum(last, ends, out=last)
    return np.where(first <= last, first, math.inf)
