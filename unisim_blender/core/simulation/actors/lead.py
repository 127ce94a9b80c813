"""What is in a moving box's way: the nearest box that it would touch, and how far it can go until then."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import BoolArray, FloatArray
from ..states import Boxes, Traffic
from .path import Sweep

_REFINEMENTS = 4


@dataclass(frozen=True)
class Lead:
    """The nearest box in the way. ``gap_m``: how far the moving box can go along its path until the two touch, negative by how
    deep they overlap. ``speed_m_s``: the other's speed along the path there; negative towards it."""

    uid: str
    gap_m: float
    speed_m_s: float


def find_lead(
    sweep: Sweep, length_m: float, width_m: float, traffic: Traffic, uid: str, ignored: Collection[str] = ()
) -> Lead | None:
    """Return the nearest box that a box touches as it moves through the poses of a sweep, or None.

    The others are taken where they are now. A box that overlaps it already is in its way only if its middle lies ahead. ``uid``
    is the moving box's own, ``ignored`` those of others that do not count.

    A box meets the swept path as soon as any part of it does, its corners first: two rectangles overlap unless a side of one
    separates them (separating axes).
    """
    boxes = traffic.boxes
    reach = math.hypot(length_m, width_m) / 2
    near = (
        (boxes.x_m + boxes.radius_m >= sweep.x_m.min() - reach)
        & (boxes.x_m - boxes.radius_m <= sweep.x_m.max() + reach)
        & (boxes.y_m + boxes.radius_m >= sweep.y_m.min() - reach)
        & (boxes.y_m - boxes.radius_m <= sweep.y_m.max() + reach)
    )
    found = [
        index
        for index in np.flatnonzero(near).tolist()
        if traffic.footprints[index].uid != uid and traffic.footprints[index].uid not in ignored
    ]
    if not found:
        return None
    half = length_m / 2, width_m / 2
    apart = separations(sweep.x_m, sweep.y_m, sweep.heading_rad, half, boxes, np.array(found))
    meets: BoolArray = apart <= 0
    for column, index in enumerate(found):
        if meets[0, column]:
            ahead = (boxes.x_m[index] - sweep.x_m[0]) * math.cos(sweep.heading_rad[0]) + (
                boxes.y_m[index] - sweep.y_m[0]
            ) * math.sin(sweep.heading_rad[0])
            if ahead * sweep.gear <= 0:
                meets[:, column] = False
    rows, columns = np.nonzero(meets)
    if not len(rows):
        return None
    first = int(rows[0])  # nonzero goes row by row
    leads = [
        (_gap(sweep, first, half, boxes, found[column], apart[:, column]), found[column])
        for column in columns[rows == first].tolist()
    ]
    gap, index = min(leads)
    turned = boxes.heading_rad[index] - sweep.heading_rad[first]
    speed = float(boxes.speed_m_s[index]) * math.cos(turned) * sweep.gear
    return Lead(traffic.footprints[index].uid, gap, speed)


def touching(
    x_m: float, y_m: float, heading_rad: float, length_m: float, width_m: float, traffic: Traffic, uid: str
) -> tuple[str, ...]:
    """Return the identifiers of the boxes that a box overlaps."""
    every = np.arange(len(traffic.footprints))
    apart = separations(
        np.array([x_m]), np.array([y_m]), np.array([heading_rad]), (length_m / 2, width_m / 2), traffic.boxes, every
    )[0]
    uids = (traffic.footprints[index].uid for index in np.flatnonzero(apart <= 0).tolist())
    return tuple(one for one in uids if one != uid)


def separations(
    x_m: FloatArray, y_m: FloatArray, heading_rad: FloatArray, half_m: tuple[float, float], boxes: Boxes, which: NDArray[np.int64]
) -> FloatArray:  # fmt: skip
    """Return how far a box at poses (K,) is from some boxes, (K, M): the largest gap between them along any of their axes, at
    most their distance; negative where they overlap, by how deep."""
    length, width = half_m
    dx, dy = boxes.x_m[which] - x_m[:, None], boxes.y_m[which] - y_m[:, None]
    own_cos, own_sin = np.cos(heading_rad)[:, None], np.sin(heading_rad)[:, None]
    cos, sin = boxes.cos[which], boxes.sin[which]
    other_length, other_width = boxes.half_length_m[which], boxes.half_width_m[which]
    c, s = np.abs(own_cos * cos + own_sin * sin), np.abs(own_cos * sin - own_sin * cos)
    apart = np.abs(dx * own_cos + dy * own_sin) - (length + other_length * c + other_width * s)
    np.maximum(apart, np.abs(dy * own_cos - dx * own_sin) - (width + other_length * s + other_width * c), out=apart)
    np.maximum(apart, np.abs(dx * cos + dy * sin) - (other_length + length * c + width * s), out=apart)
    np.maximum(apart, np.abs(dy * cos - dx * sin) - (other_width + length * s + width * c), out=apart)
    return np.asarray(apart)


def _gap(sweep: Sweep, first: int, half: tuple[float, float], boxes: Boxes, index: int, apart: FloatArray) -> float:
    """Return how far the box goes until it touches another, which it does between poses ``first - 1`` and ``first``."""
    if first == 0:
        return float(apart[0])
    which = np.array([index])
    low, high = 0.0, 1.0
    over, under = float(apart[first - 1]), float(apart[first])
    before = first - 1
    ends = [(float(row[before]), float(row[first])) for row in (sweep.x_m, sweep.y_m, sweep.heading_rad)]
    u = 1.0
    for _ in range(_REFINEMENTS):  # false position: exact at once where the gap shrinks evenly
        u = low + (high - low) * over / (over - under)
        x, y, heading = (np.array([a + u * (b - a)]) for a, b in ends)
        value = float(separations(x, y, heading, half, boxes, which)[0, 0])
        if abs(value) < 1e-3:
            break
        if value > 0:
            low, over = u, value
        else:
            high, under = u, value
    return float(sweep.s_m[before] - sweep.s_m[0]) + u * float(sweep.s_m[first] - sweep.s_m[before])
