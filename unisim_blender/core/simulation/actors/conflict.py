"""Whether two boxes meet if both go on as they move now."""

from __future__ import annotations

import math

from ..states import Footprint


def time_to_overlap(a: Footprint, b: Footprint, horizon_s: float) -> float | None:
    """Return when two boxes first overlap if each keeps its velocity, along its heading, and its heading; None where they do
    not within ``horizon_s``.

    Exact: on each axis that a side of either is normal to, the boxes overlap during one interval; they overlap where all four
    do (separating axes).
    """
    dx, dy = b.x_m - a.x_m, b.y_m - a.y_m
    cos_a, sin_a = math.cos(a.heading_rad), math.sin(a.heading_rad)
    cos_b, sin_b = math.cos(b.heading_rad), math.sin(b.heading_rad)
    vx = b.speed_m_s * cos_b - a.speed_m_s * cos_a
    vy = b.speed_m_s * sin_b - a.speed_m_s * sin_a
    c, s = abs(cos_a * cos_b + sin_a * sin_b), abs(cos_a * sin_b - sin_a * cos_b)
    first, last = 0.0, horizon_s
    for x, y, reach in (
        (cos_a, sin_a, a.length_m + b.length_m * c + b.width_m * s),
        (-sin_a, cos_a, a.width_m + b.length_m * s + b.width_m * c),
        (cos_b, sin_b, b.length_m + a.length_m * c + a.width_m * s),
        (-sin_b, cos_b, b.width_m + a.length_m * s + a.width_m * c),
    ):
        apart, speed, half = dx * x + dy * y, vx * x + vy * y, reach / 2
        if abs(speed) < 1e-12:
            if abs(apart) > half:
                return None
            continue
        one, other = (-half - apart) / speed, (half - apart) / speed
        first, last = max(first, min(one, other)), min(last, max(one, other))
        if first > last:
            return None
    return first
