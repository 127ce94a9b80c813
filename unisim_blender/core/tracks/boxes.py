"""Heading and size of boxes around returns: a search of the heading, and a size by what has been seen of each side."""

from __future__ import annotations

import numpy as np

from ..geometry import FloatArray

STEPS = 90
NEAREST_M = 0.02
TRIM = 0.004
"""Part of the returns that may lie outside of a box on each side."""


def closest_heading(xy: FloatArray) -> float:
    """Return the heading in [0, pi / 2), radians, of the rectangle whose edges lie closest to points (N, 2).

    The closeness criterion of Zhang et al., "Efficient L-shape fitting for vehicle detection using laser scanners",
    IV 2017.
    """
    angles = np.arange(STEPS) * (np.pi / 2 / STEPS)
    along = xy @ np.stack([np.cos(angles), np.sin(angles)])
    across = xy @ np.stack([-np.sin(angles), np.cos(angles)])
    depth = np.minimum(*(np.minimum(side - side.min(0), side.max(0) - side) for side in (along, across)))
    return float(angles[(1 / np.maximum(depth, NEAREST_M * 2)).sum(0).argmax()])


def extent(values: FloatArray) -> tuple[float, float]:
    """Return the ends of values (N,) without the outermost `TRIM` of them."""
    low, high = np.quantile(values, [TRIM, 1 - TRIM]) if len(values) > 20 else (values.min(), values.max())
    return float(low), float(high)


def completed(low: float, high: float, usual: float, viewed: float) -> tuple[float, float]:
    """Return the ends of a box of which returns reach from ``low`` to ``high``, and no less than ``usual`` long: it goes
    on where it is not seen. ``viewed``: the part of the views, from -1, all from the low end, to 1, from the high end."""
    lacks = max(usual - (high - low), 0.0)
    return low - lacks * (1 + viewed) / 2, high + lacks * (1 - viewed) / 2
