"""The poses of boxes that move along paths: of many paths at once, which is faster than each by itself."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray
from ...world.actor_path import ActorPath


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
    parts, lower, held = [], [], 0
    ends = at[first + count - 1].tolist()
    for way, last, begin, many in zip(ways, ends, first.tolist(), count.tolist(), strict=True):
        keys, lines = way.path.keys, way.path.lines
        low = max(bisect_right(keys, way.s_m) - 1, 0)
        high = max(bisect_right(keys, last) - 1, low)
        inside = lines[0, low + 1 : high + 1].searchsorted(at[begin : begin + many], side="right")
        parts.append(lines[:, low : high + 1])
        lower.append(inside + held)
        held += high + 1 - low
    # as np.interp does it, of three columns at once
    found = np.concatenate(parts, 1)[:, np.concatenate(lower)]
    x, y, heading = found[4:] * np.maximum(at - found[0], 0.0) + found[1:4]
    gear = np.array([way.path.gear_at(way.s_m) for way in ways], float)
    return Swept(at, x, y, heading, first, count, gear)
