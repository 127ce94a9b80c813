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


def extent(values: FloatArray) -> FloatArray:
    """Return the lowest and highest (2, D) of values (N, D) without the outermost `TRIM` of them."""
    return np.quantile(values, [TRIM, 1 - TRIM] if len(values) > 20 else [0.0, 1.0], axis=0)


def viewed_from(ends: FloatArray, usual: FloatArray, origins: FloatArray) -> FloatArray:
    """Return from where views (N, D) see a box whose returns reach from and to ``ends`` (2, D), and that is no shorter than
    ``usual`` (D,): (D,) from -1, all from the low end, to 1, from the high end."""
    length = np.maximum(np.ptp(ends, 0), usual)
    return np.asarray(np.clip((origins - ends.mean(0)) / length, -1, 1).mean(0))


def completed(ends: FloatArray, usual: FloatArray, viewed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return middle (D,) and edges (D,) of a box of which returns reach from and to ``ends`` (2, D), and no less than
    ``usual`` (D,) long: it goes on where it is not seen. ``viewed``: see `viewed_from`."""
    lacks = np.maximum(usual - np.ptp(ends, 0), 0.0)
    return ends.mean(0) - lacks * viewed / 2, np.ptp(ends, 0) + lacks
