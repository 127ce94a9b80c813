"""Whether boxes meet if they go on as they move now."""

from __future__ import annotations

import math

import numpy as np

from ...geometry import FloatArray
from ..states import Boxes, Footprint, Traffic

LEAST_RATE_M_S = 1e-12
"""What moves more slowly along an axis stands still there."""


def time_to_overlap(a: Footprint, b: Footprint, horizon_s: float) -> float | None:
    """Return when two boxes first overlap if each keeps its velocity, along its heading, and its heading; None where they do
    not within ``horizon_s``."""
    first = float(times_to_overlap(Traffic(0, (a,)).boxes, Traffic(0, (b,)).boxes)[0, 0])
    return first if first <= horizon_s else None


def times_to_overlap(a: Boxes, b: Boxes) -> FloatArray:
    """Return when boxes (N,) first overlap others (M,) if each keeps its velocity, along its heading, and its heading: seconds
    (N, M), inf where they never do.

    Exact: on each axis that a side of either is normal to, two boxes overlap during one interval; they overlap where all four
    do (separating axes).
    """
    dx, dy = b.x_m - a.x_m[:, None], b.y_m - a.y_m[:, None]
    cos, sin = a.cos[:, None], a.sin[:, None]
    vx = b.speed_m_s * b.cos - a.speed_m_s[:, None] * cos
    vy = b.speed_m_s * b.sin - a.speed_m_s[:, None] * sin
    c, s = np.abs(cos * b.cos + sin * b.sin), np.abs(cos * b.sin - sin * b.cos)
    length, width = a.half_length_m[:, None], a.half_width_m[:, None]
    first, last = np.zeros(dx.shape), np.full(dx.shape, math.inf)
    for x, y, half in (
        (cos, sin, length + b.half_length_m * c + b.half_width_m * s),
        (-sin, cos, width + b.half_length_m * s + b.half_width_m * c),
        (b.cos, b.sin, b.half_length_m + length * c + width * s),
        (-b.sin, b.cos, b.half_width_m + length * s + width * c),
    ):
        apart, speed = dx * x + dy * y, vx * x + vy * y
        still = np.abs(speed) < LEAST_RATE_M_S
        safe = np.where(still, 1.0, speed)
        one, other = (-half - apart) / safe, (half - apart) / safe
        beside = np.abs(apart) > half
        begins = np.where(still, np.where(beside, math.inf, 0.0), np.minimum(one, other))
        ends = np.where(still, math.inf, np.maximum(one, other))
        np.maximum(first, begins, out=first)
        np.minimum(last, ends, out=last)
    return np.where(first <= last, first, math.inf)
