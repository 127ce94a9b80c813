"""Class, size and middle of an actor by its returns of all sweeps in its own frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from .boxes import completed, extent

USUAL_M = {
    "Car": (4.55, 1.88, 1.5),
    "Truck": (6.5, 2.4, 2.6),
    "Bus": (11.0, 2.7, 3.1),
    "Cyclist": (1.75, 0.7, 1.7),
    "Pedestrian": (0.75, 0.7, 1.7),
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
    """A class, the edges (3,) of the box, and its middle (3,) in the frame that the returns are in, z above the ground."""

    label: str
    size_m: FloatArray
    middle: FloatArray
    seen: float
    """The part of the usual width that returns cover across the way: little of a piece of a wall, along which a false track
    slides; 0.25 of what is far too wide."""


def supported(points: FloatArray, sweep: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return whether points (N, 3) lie where more than one sweep shows some."""
    cell = np.floor(points / VOXEL_M).astype(np.int64)
    cell -= cell.min(0)
    span = cell.max(0) + 1
    key = (cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2]
    pairs = np.unique(np.stack([key, sweep], 1), axis=0)
    keys, counts = np.unique(pairs[:, 0], return_counts=True)
    return np.asarray(counts[np.searchsorted(keys, key)] > 1)


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
    ends = [extent(points[:, axis]) for axis in range(3)]
    length, width = (high - low for low, high in ends[:2])
    top = ends[2][1]
    inner = [np.quantile(points[:, axis], INNER).tolist() for axis in (0, 1)]
    if (
        class_of(inner[0][1] - inner[0][0], inner[1][1] - inner[1][0], top, speed) in NARROW
    ):  # what is beside it is not its own
        ends[:2] = [(low, high) for low, high in inner]
        length, width = (high - low for low, high in ends[:2])
    label = class_of(length, width, top, speed)
    usual = USUAL_M[label]
    size, middle = np.zeros(3), np.zeros(3)
    seen = width / usual[1] if width < TOO_WIDE * usual[1] else 0.25
    for axis in (0, 1):
        low, high = ends[axis]
        half = max(high - low, usual[axis]) / 2
        viewed = float(np.clip((origins[:, axis] - (low + high) / 2) / half / 2, -1, 1).mean())
        low, high = completed(low, high, usual[axis], viewed)
        size[axis], middle[axis] = high - low, (high + low) / 2
    is_own = (len(points) > 30 or top > usual[2]) and not (label in NARROW and top > TALLEST_M)
    size[2] = top if is_own else usual[2]
    middle[2] = size[2] / 2
    return Shape(label, size, middle, seen)
