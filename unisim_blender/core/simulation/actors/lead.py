"""The leads of moving boxes: the nearest box that each would touch, and how far it can go until then.

The poses along many paths are computed at once, which is faster than each by itself."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import BoolArray, FloatArray
from ...world.actor_path import ActorPath
from ..states import Footprint, FootprintArrays, Traffic


@dataclass(frozen=True)
class Way:
    """Part of a path: from arc length ``s_m`` on, over ``horizon_m``, in poses ``step_m`` apart."""

    path: ActorPath
    s_m: float
    horizon_m: float
    step_m: float


@dataclass(frozen=True, eq=False)
class Swept:
    """The poses along ways in a row: arc lengths, places and headings (R,); ``first`` and ``count`` (N,) of each way's, and its
    ``gear`` (N,): 1 where the box moves along its heading, -1 where it moves backward."""

    s_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    first: NDArray[np.int64]
    count: NDArray[np.int64]
    gear: FloatArray


def swept(ways: Sequence[Way]) -> Swept:
    """Return the poses along ways, one at least."""
    count = np.array([max(int(math.ceil(way.horizon_m / way.step_m)), 1) + 1 for way in ways])
    first = np.cumsum(count) - count
    starts, steps = np.array([(way.s_m, way.step_m) for way in ways]).T
    number = np.arange(int(count.sum())) - np.repeat(first, count)
    at = np.repeat(starts, count) + number * np.repeat(steps, count)
    # of each path only the keys about its way
    parts, lower, offset = [], [], 0
    ends = at[first + count - 1].tolist()
    for way, last, begin, many in zip(ways, ends, first.tolist(), count.tolist(), strict=True):
        keys, lines = way.path.keys, way.path.lines
        low = max(bisect_right(keys, way.s_m) - 1, 0)
        high = max(bisect_right(keys, last) - 1, low)
        inside = lines[0, low + 1 : high + 1].searchsorted(at[begin : begin + many], side="right")
        parts.append(lines[:, low : high + 1])
        lower.append(inside + offset)
        offset += high + 1 - low
    # as np.interp does it, of three columns at once
    poses = np.concatenate(parts, 1)[:, np.concatenate(lower)]
    x, y, heading = poses[4:] * np.maximum(at - poses[0], 0.0) + poses[1:4]
    gear = np.array([way.path.gear_at(way.s_m) for way in ways], float)
    return Swept(at, x, y, heading, first, count, gear)


_REFINEMENTS = 8
_CLOSE_M = 1e-3
"""Precision of a gap."""


_SLACK_M = 1.0
"""Poses may be so much further apart than they are along their path."""


_Indices = NDArray[np.int64]
_Meetings = tuple[_Indices, _Indices, _Indices, FloatArray, _Indices]


@dataclass(frozen=True)
class Lead:
    """The nearest box in the way. ``gap_m``: how far the moving box can go along its path until the two touch, negative by how
    deep they overlap. ``speed_m_s``: the other's speed along the path there; negative towards it."""

    uid: str
    gap_m: float
    speed_m_s: float


@dataclass(frozen=True, eq=False)
class Search(Way):
    """Where a box goes whose lead is looked for. ``uid`` is its own, ``ignored`` those of boxes that do not count."""

    uid: str
    length_m: float
    width_m: float
    ignored: Collection[str] = ()


def find_leads(searches: Sequence[Search], traffic: Traffic) -> list[Lead | None]:
    """Return for each search the nearest box that its box touches as it moves, or None; all searches at once.

    The others are taken where they are now. A box that overlaps one already is in its way only if its middle lies ahead.

    A box meets the swept path as soon as any part of it does, its corners first: two rectangles overlap unless a side of one
    separates them (separating axes).
    """
    leads: list[Lead | None] = [None] * len(searches)
    if not searches or not traffic.footprints:
        return leads
    counting = _counting(searches, traffic)
    near = np.flatnonzero((_in_reach(searches, traffic.boxes) & counting).any(1))
    if not len(near):
        return leads
    searches = [searches[index] for index in near.tolist()]
    boxes, way, half = traffic.boxes, swept(searches), _halves(searches)
    search, other, pose, apart, pair = _meetings(searches, way, half, boxes, counting[near])
    if not len(pose):
        return leads
    # a box that is touched at the start and lies behind is not in the way
    dx, dy = boxes.x_m[other] - way.x_m[pose], boxes.y_m[other] - way.y_m[pose]
    heading = way.heading_rad[pose]
    ahead = (dx * np.cos(heading) + dy * np.sin(heading)) * way.gear[search] > 0
    behind = np.zeros(int(pair.max()) + 1, bool)
    behind[pair[(pose == way.first[search]) & ~ahead]] = True
    not_behind = ~behind[pair]
    search, other, pose, apart = search[not_behind], other[not_behind], pose[not_behind], apart[not_behind]
    met, begins = np.unique(search, return_index=True)
    if not len(met):
        return leads
    first = np.zeros(len(searches), np.int64)
    first[met] = np.minimum.reduceat(pose, begins)
    nearest = pose == first[search]
    search, other, pose, apart = search[nearest], other[nearest], pose[nearest], apart[nearest]
    gaps = _gaps(way, half[:, search], search, pose, boxes, other, apart)
    turned = boxes.heading_rad[other] - way.heading_rad[pose]
    speeds = boxes.speed_m_s[other] * np.cos(turned) * way.gear[search]
    order = np.lexsort((other, gaps, search))
    nearest = order[np.unique(search[order], return_index=True)[1]]
    columns = (column[nearest].tolist() for column in (search, other, gaps, speeds))
    for row, box, gap_m, speed_m_s in zip(*columns, strict=True):
        leads[near[row]] = Lead(traffic.footprints[box].uid, gap_m, speed_m_s)
    return leads


def _counting(searches: Sequence[Search], traffic: Traffic) -> BoolArray:
    """Return which boxes count for searches: all (N, M) but their own and those that they ignore."""
    counting = np.ones((len(searches), len(traffic.footprints)), bool)
    places = [traffic.places_of(search.uid, search.ignored) for search in searches]
    rows = np.repeat(np.arange(len(searches)), [len(row) for row in places])
    counting[rows, [place for row in places for place in row]] = False
    return counting


def _in_reach(searches: Sequence[Search], boxes: FootprintArrays) -> BoolArray:
    """Return whether boxes are so near to the starts of searches that they can be in the way: (N, M)."""
    starts = np.array([search.path.point(search.s_m) for search in searches])
    reach = np.array(
        [search.horizon_m + search.step_m + math.hypot(search.length_m, search.width_m) / 2 for search in searches]
    )
    apart = np.hypot(boxes.x_m - starts[:, :1], boxes.y_m - starts[:, 1:]) - boxes.radius_m
    return np.asarray(apart <= reach[:, None] + 1.0)


def _halves(searches: Sequence[Search]) -> FloatArray:
    """Return half the lengths and half the widths (2, N) of searches' boxes."""
    return np.array([(search.length_m / 2, search.width_m / 2) for search in searches]).T


def _meetings(
    searches: Sequence[Search], way: Swept, half_m: FloatArray, boxes: FootprintArrays, counting: BoolArray
) -> _Meetings:
    """Return where searches' boxes overlap others (P,) of those that count (N, M): the search, the other box, the pose, how deep
    they overlap, and a number of the search and the other box together. By search, other box and pose."""
    reach = np.hypot(*half_m)
    # all poses of a search lie within half its length of its middle one
    middle, last = way.first + way.count // 2, way.first + way.count - 1
    extent = (way.s_m[last] - way.s_m[way.first]) / 2 + _SLACK_M + np.array([search.step_m for search in searches])
    dx, dy = boxes.x_m - way.x_m[middle, None], boxes.y_m - way.y_m[middle, None]
    near = dx * dx + dy * dy <= (boxes.radius_m + (reach + extent)[:, None]) ** 2
    searched, others = np.nonzero(near & counting)
    # a box so far from the first pose, or the last one, meets none that is nearer to that along the path
    reached = (boxes.radius_m[others] + reach[searched]) + _SLACK_M
    spacing = np.array([search.step_m for search in searches])[searched]
    skipped = [
        np.floor((np.hypot(boxes.x_m[others] - way.x_m[end], boxes.y_m[others] - way.y_m[end]) - reached) / spacing)
        for end in (way.first[searched], last[searched])
    ]
    ahead, behind = (np.clip(count, 0, way.count[searched]).astype(np.int64) for count in skipped)
    counts = np.maximum(way.count[searched] - ahead - behind, 0)
    pair = np.repeat(np.arange(len(searched)), counts)
    pose = np.arange(len(pair)) - np.repeat(np.cumsum(counts) - counts - way.first[searched] - ahead, counts)
    other = others[pair]
    dx, dy = boxes.x_m[other] - way.x_m[pose], boxes.y_m[other] - way.y_m[pose]
    close = dx * dx + dy * dy <= (boxes.radius_m[others] + reach[searched])[pair] ** 2
    pair, pose, other, dx, dy = (values[close] for values in (pair, pose, other, dx, dy))
    search = searched[pair]
    cos, sin = np.cos(way.heading_rad), np.sin(way.heading_rad)
    apart = pair_separations((dx, dy), (cos[pose], sin[pose]), half_m[:, search], boxes, other)
    met = apart <= 0
    return search[met], other[met], pose[met], apart[met], pair[met]


def touching(box: Footprint, traffic: Traffic) -> tuple[str, ...]:
    """Return the identifiers of the other boxes that a box overlaps."""
    every, half = np.arange(len(traffic.footprints)), (box.length_m / 2, box.width_m / 2)
    x, y, heading = (np.array([value]) for value in (box.x_m, box.y_m, box.heading_rad))
    apart = separations(x, y, heading, half, traffic.boxes, every)[0]
    uids = (traffic.footprints[index].uid for index in np.flatnonzero(apart <= 0).tolist())
    return tuple(uid for uid in uids if uid != box.uid)


def separations(
    x_m: FloatArray,
    y_m: FloatArray,
    heading_rad: FloatArray,
    half_m: tuple[float, float],
    boxes: FootprintArrays,
    which: NDArray[np.int64],
) -> FloatArray:
    """Return how far a box at poses (K,) is from some boxes, (K, M): the largest gap between them along any of their axes, at
    most their distance; negative where they overlap, by how deep."""
    dx, dy = boxes.x_m[which] - x_m[:, None], boxes.y_m[which] - y_m[:, None]
    turned = np.cos(heading_rad)[:, None], np.sin(heading_rad)[:, None]
    return pair_separations((dx, dy), turned, half_m, boxes, which)


def pair_separations(
    offset_m: tuple[FloatArray, FloatArray],
    turned: tuple[FloatArray, FloatArray],
    half_m: FloatArray | tuple[float, float],
    boxes: FootprintArrays,
    which: NDArray[np.int64],
) -> FloatArray:
    """As `separations`, of pairs of a pose and a box; ``offset_m`` is from the pose to the box's middle, ``turned`` the cosines
    and sines of the poses' headings."""
    (dx, dy), (length, width), (own_cos, own_sin) = offset_m, half_m, turned
    cos, sin = boxes.cos[which], boxes.sin[which]
    other_length, other_width = boxes.half_length_m[which], boxes.half_width_m[which]
    c, s = np.abs(own_cos * cos + own_sin * sin), np.abs(own_cos * sin - own_sin * cos)
    apart = np.abs(dx * own_cos + dy * own_sin) - (length + other_length * c + other_width * s)
    np.maximum(apart, np.abs(dy * own_cos - dx * own_sin) - (width + other_length * s + other_width * c), out=apart)
    np.maximum(apart, np.abs(dx * cos + dy * sin) - (other_length + length * c + width * s), out=apart)
    np.maximum(apart, np.abs(dy * cos - dx * sin) - (other_width + length * s + width * c), out=apart)
    return np.asarray(apart)


def _gaps(
    way: Swept,
    half_m: FloatArray,
    search: NDArray[np.int64],
    pose: NDArray[np.int64],
    boxes: FootprintArrays,
    other: NDArray[np.int64],
    apart_m: FloatArray,
) -> FloatArray:
    """Return how far boxes go until they touch others (P,), which they do between a pose and the one before, where they are
    ``apart_m`` from them; that itself where they touch at the start."""
    gaps = apart_m.copy()
    later = np.flatnonzero(pose > way.first[search])
    if not len(later):
        return gaps
    search, pose, other, half = search[later], pose[later], other[later], half_m[:, later]
    (x0, x1), (y0, y1), (turn0, turn1), (s0, s1) = (
        (array[pose - 1], array[pose]) for array in (way.x_m, way.y_m, way.heading_rad, way.s_m)
    )
    x, y = boxes.x_m[other], boxes.y_m[other]

    def at(u: FloatArray) -> FloatArray:
        offset = x - x0 - u * (x1 - x0), y - y0 - u * (y1 - y0)
        heading = turn0 + u * (turn1 - turn0)
        return pair_separations(offset, (np.cos(heading), np.sin(heading)), half, boxes, other)

    low, high, u = np.zeros(len(later)), np.ones(len(later)), np.ones(len(later))
    over, under = at(low), apart_m[later].copy()
    goes_on = np.ones(len(later), bool)
    for _ in range(_REFINEMENTS):  # false position: exact at once where the gap shrinks evenly
        u = np.where(goes_on, low + (high - low) * over / np.where(goes_on, over - under, 1.0), u)
        value = at(u)
        goes_on &= np.abs(value) >= _CLOSE_M
        if not goes_on.any():
            break
        above, below = goes_on & (value > 0), goes_on & (value <= 0)
        low, over = np.where(above, u, low), np.where(above, value, over)
        high, under = np.where(below, u, high), np.where(below, value, under)
    gaps[later] = s0 - way.s_m[way.first[search]] + u * (s1 - s0)
    return gaps
