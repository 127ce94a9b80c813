"""Where a dragged point is: a ray under the mouse on a plane, or nearest to a line."""

from __future__ import annotations

import numpy as np

from ...core.geometry import FloatArray


def on_plane(origin: FloatArray, direction: FloatArray, point: FloatArray, normal: FloatArray) -> FloatArray | None:
    """Return where a ray hits the plane through a point; None where it runs along it or away from it."""
    along = float(direction @ normal)
    if abs(along) < 1e-6:
        return None
    away = float((point - origin) @ normal) / along
    return None if away <= 0 else np.asarray(origin + away * direction)


def along_axis(origin: FloatArray, direction: FloatArray, point: FloatArray, line: FloatArray) -> float:
    """Return how far from a point along a unit ``line`` (3,) that line is nearest to a ray."""
    unit = direction / np.linalg.norm(direction)
    across = float(unit @ line)
    apart = origin - point
    return float((apart @ line - across * (apart @ unit)) / max(1 - across**2, 1e-9))


def stepped(value: float, step: float, in_steps: bool) -> float:
    """Return a value, in steps where that is asked for."""
    return round(value / step) * step if in_steps else value
