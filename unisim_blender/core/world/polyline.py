"""Polylines in the plane, and projection of points onto them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray

ALONG_WEIGHT = 0.1
"""Weight of a metre along a polyline relative to a metre aside, where it passes a point more than once."""


class Projection(NamedTuple):
    """The place of a polyline that is nearest to a point, metres: its arc length, the point's distance to the left of
    the segment there, and its distance from the place, which is larger at corners and ends. ``segment`` counts from
    that before the first point, if there is one."""

    along_m: float
    left_m: float
    away_m: float
    segment: int


@dataclass(frozen=True, eq=False)
class Polyline:
    """Straight segments through points (N, 2), N >= 1.

    ``along_m`` (N,) are arc lengths. It goes on straight before its first point and after its last one where ``before``
    and ``after``, unit directions (2,), say so.
    """

    points: FloatArray
    along_m: FloatArray
    before: FloatArray | None = None
    after: FloatArray | None = None

    @staticmethod
    def through(points: FloatArray, before: FloatArray | None = None, after: FloatArray | None = None) -> Polyline:
        """Return the polyline through points (N, 2), with arc lengths from 0."""
        legs = np.diff(points, axis=0)
        return Polyline(points, np.append(0.0, np.cumsum(np.hypot(legs[:, 0], legs[:, 1]))), before, after)

    @property
    def length_m(self) -> float:
        return float(self.along_m[-1] - self.along_m[0])

    @cached_property
    def _segments(self) -> tuple[FloatArray, ...]:
        """For each segment: x and y of its start, its unit direction, its start's arc length, and from where to where
        it goes from there."""
        starts, legs = self.points[:-1], np.diff(self.points, axis=0)
        lengths = np.hypot(legs[:, 0], legs[:, 1])
        units = legs / np.where(lengths > 0, lengths, 1.0)[:, None]
        arcs, lows, highs = self.along_m[:-1], np.zeros(len(lengths)), lengths
        if self.before is not None:
            starts, units = np.concatenate([self.points[:1], starts]), np.concatenate([self.before[None], units])
            arcs = np.append(self.along_m[0], arcs)
            lows, highs = np.append(-math.inf, lows), np.append(0.0, highs)
        if self.after is not None or not len(starts):  # a point alone is a segment without a length
            onward = np.zeros(2) if self.after is None else self.after
            starts, units = np.concatenate([starts, self.points[-1:]]), np.concatenate([units, onward[None]])
            arcs, lows = np.append(arcs, self.along_m[-1]), np.append(lows, 0.0)
            highs = np.append(highs, 0.0 if self.after is None else math.inf)
        return starts[:, 0].copy(), starts[:, 1].copy(), units[:, 0].copy(), units[:, 1].copy(), arcs, lows, highs

    def project(self, x_m: float, y_m: float, near_m: float | None = None) -> Projection:
        """Return the projection of the point (``x_m``, ``y_m``). With ``near_m``, of several parts that pass there the
        one near that arc length is taken."""
        x, y, dx, dy, arcs, lows, highs = self._segments
        to_x, to_y = x_m - x, y_m - y
        on = np.clip(to_x * dx + to_y * dy, lows, highs)
        squared = np.square(to_x - on * dx) + np.square(to_y - on * dy)
        along = arcs + on
        i = int(np.argmin(squared if near_m is None else squared + np.square(ALONG_WEIGHT * (along - near_m))))
        if near_m is not None:  # the pull chooses the part, the distance the place on it
            while i > 0 and squared[i - 1] < squared[i]:
                i -= 1
            while i + 1 < len(squared) and squared[i + 1] < squared[i]:
                i += 1
        left = float(dx[i] * to_y[i] - dy[i] * to_x[i])
        return Projection(float(along[i]), left, math.sqrt(float(squared[i])), i)

    def follow(self, points: FloatArray, near_m: float) -> tuple[FloatArray, FloatArray]:
        """Return the arc lengths (T,) and the distances (T,), left positive, of consecutive points (T, 2), metres.

        The first is looked for near an arc length, each other one near the one before: a polyline that crosses itself
        is followed and not jumped along.
        """
        along, across = np.empty(len(points)), np.empty(len(points))
        for index, (x, y) in enumerate(points.tolist()):
            near_m, left, away, _ = self.project(x, y, near_m)
            along[index], across[index] = near_m, math.copysign(away, left)
        return along, across

    def distances(self, points: FloatArray) -> FloatArray:
        """Return the distances (K,), metres, of points (K, 2)."""
        x, y, dx, dy, _, lows, highs = self._segments
        to_x, to_y = points[:, :1] - x, points[:, 1:] - y
        on = np.clip(to_x * dx + to_y * dy, lows, highs)
        return np.asarray(np.hypot(to_x - on * dx, to_y - on * dy).min(1))


def spaced(points: FloatArray, least_m: float) -> NDArray[np.int64]:
    """Return the indices of the points (N, 2) that are ``least_m`` or more from the kept one before; the first one is
    kept."""
    indices = [0]
    last_x, last_y = points[0].tolist()
    for index, (x, y) in enumerate(points[1:].tolist(), 1):
        if math.hypot(x - last_x, y - last_y) >= least_m:
            indices.append(index)
            last_x, last_y = x, y
    return np.array(indices)
