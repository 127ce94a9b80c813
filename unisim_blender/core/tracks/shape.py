"""Class, size and middle of an actor by its returns of all sweeps in its own frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from .boxes import completed, extent, viewed_from

USUAL_M = {
    "Car": (4.55, 1.88, 1.5),
    "Truck": (6.5, 2.4, 2.6),
    "Bus": (11.0, 2.7, 3.1),
    "Cyclist": (1.75, 0.7, 1.7),
    "Pedestrian": (0.75, 0.7, 1.7),
    "Cones": (0.4, 0.4, 0.75),
}
"""Size (length, width, height) of a class where nothing shows another."""
VEHICLES = ("Car", "Truck", "Bus")
"""Classes that go where they look."""
VOXEL_M = 0.2
TOO_WIDE = 1.6
INNER = (0.03, 0.97)
"""Quantiles of returns between which people and riders are looked for."""
NARROW = ("Cyclist", "Pedestrian")
TALLEST_M = 2.2
"""What is higher above somebody, a branch or a sign, is not their own."""


@dataclass(frozen=True)
class Shape:
    """A class, the edges (3,) of the box, and its middle (2,) in the frame that the returns are in."""

    label: str
    size_m: FloatArray
    middle: FloatArray
    seen: float
    """The part of the usual width that returns cover across the way: little of a piece of a wall, along which a false track
    slides; 0.25 of what is far too wide."""


def supported(points: FloatArray, sweep: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether points (N, 3) lie where more than one sweep shows some."""
    _, cell = np.unique(np.floor(points / VOXEL_M), axis=0, return_inverse=True)
    pairs = np.unique(np.stack([cell.ravel(), sweep], 1), axis=0)
    return np.asarray(np.bincount(pairs[:, 0])[cell.ravel()] > 1)


def class_of(length: float, width: float, height: float, speed: float) -> str:
    """Return the class of what is seen to be this large, metres, and goes this fast at times, m/s."""
    if length > 9.5 and height > 2.4:
        return "Bus"
    if (height > 2.3 and width > 1.5) or length > 6.3:
        return "Truck"
    if width < 1.1 and length < 2.5 and height > 0.9:
        if speed > 2.8 and length > 1.0 and speed < 14:
            return "Cyclist"
        if speed < 3.2 and length < 1.5:
            return "Pedestrian"
    return "Car"


def shape_of(points: FloatArray, origins: FloatArray, speed: float) -> Shape:
    """Return the shape of an actor's returns (N, 3) in its frame, z above the ground, of rays from origins (N, 2)."""
    ends = extent(points)
    inner, top = np.quantile(points[:, :2], INNER, axis=0), float(ends[1, 2])
    if (
        class_of(float(np.ptp(inner[:, 0])), float(np.ptp(inner[:, 1])), top, speed) in NARROW
    ):  # what is beside it is not its own
        ends[:, :2] = inner
    length, width = np.ptp(ends[:, :2], 0).tolist()
    label = class_of(length, width, top, speed)
    usual = np.array(USUAL_M[label])
    middle, size = completed(ends[:, :2], usual[:2], viewed_from(ends[:, :2], usual[:2], origins))
    is_own = (len(points) > 30 or top > usual[2]) and not (label in NARROW and top > TALLEST_M)
    seen = width / float(usual[1]) if width < TOO_WIDE * usual[1] else 0.25
    return Shape(label, np.append(size, top if is_own else usual[2]), middle, seen)
