"""What is in a moving box's way: the nearest box that it would touch, and how far it can go until then."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray
from ..states import Boxes, Traffic
from .path import Sweep

_REFINEMENTS = 8


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
    boxes, reach = traffic.boxes, math.hypot(length_m, width_m) / 2
    # all poses lie within half the sweep's length of its middle
    middle, extent = len(sweep.s_m) // 2, float(sweep.s_m[-1] - sweep.s_m[0]) / 2 + 1.0
    extent += float(sweep.s_m[1] - sweep.s_m[0])
    dx, dy = boxes.x_m - sweep.x_m[middle], boxes.y_m - sweep.y_m[middle]
    reaches = boxes.radius_m + reach
    found = np.flatnonzero(dx * dx + dy * dy <= (reaches + extent) ** 2)
    left_out = traffic.places_of(uid, ignored)
    if left_out:
        found = found[~np.isin(found, left_out)] if len(left_out) > 1 else found[found != left_out[0]]
    if not len(found):
        return None
    dx, dy = boxes.x_m[found] - sweep.x_m[:, None], boxes.y_m[found] - sweep.y_m[:, None]
    rows, columns = np.nonzero(dx * dx + dy * dy <= reaches[found] ** 2)
    if not len(rows):
        return None
    others, half = found[columns], (length_m / 2, width_m / 2)
    apart = pair_separations((dx[rows, columns], dy[rows, columns]), sweep.heading_rad[rows], half, boxes, others)
    met = [(int(rows[pair]), int(others[pair]), float(apart[pair])) for pair in np.flatnonzero(apart <= 0)]
    if met and met[0][0] == 0:
        behind = {index for row, index, _ in met if row == 0 and not _is_ahead(sweep, boxes, index)}
        met = [one for one in met if one[1] not in behind]
    if not met:
        return None
    first = met[0][0]  # nonzero goes row by row
    leads = [(_gap(sweep, first, half, boxes, index, depth), index) for row, index, depth in met if row == first]
    gap, index = min(leads)
    turned = boxes.heading_rad[index] - sweep.heading_rad[first]
    speed = float(boxes.speed_m_s[index]) * math.cos(turned) * sweep.gear
    return Lead(traffic.footprints[index].uid, gap, speed)


def _is_ahead(sweep: Sweep, boxes: Boxes, index: int) -> bool:
    """Return whether a box's middle lies ahead of the first pose's."""
    heading = float(sweep.heading_rad[0])
    dx, dy = float(boxes.x_m[index] - sweep.x_m[0]), float(boxes.y_m[index] - sweep.y_m[0])
    return (dx * math.cos(heading) + dy * math.sin(heading)) * sweep.gear > 0


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
    dx, dy = boxes.x_m[which] - x_m[:, None], boxes.y_m[which] - y_m[:, None]
    return pair_separations((dx, dy), heading_rad[:, None], half_m, boxes, which)


def pair_separations(
    offset_m: tuple[FloatArray, FloatArray], heading_rad: FloatArray, half_m: tuple[float, float], boxes: Boxes,
    which: NDArray[np.int64],
) -> FloatArray:  # fmt: skip
    """As `separations`, of pairs of a pose and a box; ``offset_m`` is from the pose to the box's middle."""
    (dx, dy), (length, width) = offset_m, half_m
    own_cos, own_sin = np.cos(heading_rad), np.sin(heading_rad)
    cos, sin = boxes.cos[which], boxes.sin[which]
    other_length, other_width = boxes.half_length_m[which], boxes.half_width_m[which]
    c, s = np.abs(own_cos * cos + own_sin * sin), np.abs(own_cos * sin - own_sin * cos)
    apart = np.abs(dx * own_cos + dy * own_sin) - (length + other_length * c + other_width * s)
    np.maximum(apart, np.abs(dy * own_cos - dx * own_sin) - (width + other_length * s + other_width * c), out=apart)
    np.maximum(apart, np.abs(dx * cos + dy * sin) - (other_length + length * c + width * s), out=apart)
    np.maximum(apart, np.abs(dy * cos - dx * sin) - (other_width + length * s + width * c), out=apart)
    return np.asarray(apart)


def _separation(
    dx: float, dy: float, heading: float, half_m: tuple[float, float], other: tuple[float, float, float, float]
) -> float:
    """As `pair_separations`, of one pair and without arrays; ``other``: cosine, sine, half length and half width."""
    (length, width), (cos, sin, other_length, other_width) = half_m, other
    own_cos, own_sin = math.cos(heading), math.sin(heading)
    c, s = abs(own_cos * cos + own_sin * sin), abs(own_cos * sin - own_sin * cos)
    return max(
        abs(dx * own_cos + dy * own_sin) - (length + other_length * c + other_width * s),
        abs(dy * own_cos - dx * own_sin) - (width + other_length * s + other_width * c),
        abs(dx * cos + dy * sin) - (other_length + length * c + width * s),
        abs(dy * cos - dx * sin) - (other_width + length * s + width * c),
    )


def _gap(sweep: Sweep, first: int, half_m: tuple[float, float], boxes: Boxes, index: int, apart_m: float) -> float:
    """Return how far the box goes until it touches another, which it does between poses ``first - 1`` and ``first``, where it
    is ``apart_m`` from it."""
    if first == 0:
        return apart_m
    arrays = boxes.cos, boxes.sin, boxes.half_length_m, boxes.half_width_m
    cos, sin, length, width = (float(array[index]) for array in arrays)
    x, y = float(boxes.x_m[index]), float(boxes.y_m[index])
    (x0, x1), (y0, y1), (turn0, turn1), (s0, s1) = (
        array[first - 1 : first + 1].tolist() for array in (sweep.x_m, sweep.y_m, sweep.heading_rad, sweep.s_m)
    )

    def at(u: float) -> float:
        dx, dy = x - x0 - u * (x1 - x0), y - y0 - u * (y1 - y0)
        return _separation(dx, dy, turn0 + u * (turn1 - turn0), half_m, (cos, sin, length, width))

    low, high, over, under, u = 0.0, 1.0, at(0.0), apart_m, 1.0
    for _ in range(_REFINEMENTS):  # false position: exact at once where the gap shrinks evenly
        u = low + (high - low) * over / (over - under)
        value = at(u)
        if abs(value) < 1e-3:
            break
        if value > 0:
            low, over = u, value
        else:
            high, under = u, value
    return s0 - float(sweep.s_m[0]) + u * (s1 - s0)
