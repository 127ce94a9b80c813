"""Whether boxes meet if they go on as they move now."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ...geometry import BoolArray, FloatArray
from ..states import Footprint, FootprintArrays

LEAST_RATE_M_S = 1e-12
"""What moves more slowly along an axis stands still there."""
ROUNDING_M = 1e-3
"""Circles that are so far apart touch."""


def time_to_overlap(a: Footprint, b: Footprint, horizon_s: float) -> float | None:
    """Return when two boxes first overlap if each keeps its velocity, along its heading, and its heading; None where they do
    not within ``horizon_s``."""
    # as `_first_overlaps`: for two boxes numbers are faster than arrays
    dx, dy = b.x_m - a.x_m, b.y_m - a.y_m
    a_cos, a_sin, b_cos, b_sin = (of(one.heading_rad) for one in (a, b) for of in (math.cos, math.sin))
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
        one, other = (-half - apart) / speed, (half - apart) / speed
        first, last = max(first, min(one, other)), min(last, max(one, other))
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
    found = np.full(near.shape, math.inf)
    own, other = np.nonzero(near)
    found[own, other] = _first_overlaps(a, b, own, other)
    return found


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
        one, two = (-half - apart) / safe, (half - apart) / safe
        beside = np.abs(apart) > half
        begins = np.where(still, np.where(beside, math.inf, 0.0), np.minimum(one, two))
        ends = np.where(still, math.inf, np.maximum(one, two))
        np.maximum(first, begins, out=first)
        np.minimum(last, ends, out=last)
    return np.where(first <= last, first, math.inf)
