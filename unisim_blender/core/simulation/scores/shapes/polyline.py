"""A path in the plane by its arc length, and where points are along and across it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ....geometry import FloatArray
from .boxes import directions

LEAST_SEGMENT_M = 0.05
"""Keys that are nearer to the last one are left out: where the vehicle stands, the noise of its poses is no path."""
SEARCH_M = 5.0
"""How much further than it has moved a point may get along the path from one to the next, so that a path that crosses
itself is followed and not jumped along."""


@dataclass(frozen=True, eq=False)
class Polyline:
    """A path of points (N, 2), N >= 1, that goes on straight before its first point and after its last.

    ``arc_m`` (N,) is the distance along the path, ``before`` and ``after`` (2,) are the unit directions of its ends.
    """

    points: FloatArray
    arc_m: FloatArray
    before: FloatArray
    after: FloatArray

    @staticmethod
    def through(positions: FloatArray, first_heading_rad: float, last_heading_rad: float) -> Polyline:
        """The path through positions (K, 2) in order; it goes on along the headings at its ends."""
        kept = [0]
        for index in range(1, len(positions)):
            if np.hypot(*(positions[index] - positions[kept[-1]])) >= LEAST_SEGMENT_M:
                kept.append(index)
        points = np.asarray(positions[kept], np.float64)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1))])
        before, after = directions(np.array([first_heading_rad, last_heading_rad]))
        if len(points) > 1:  # a vehicle that backs up goes against its heading
            before = np.copysign(1.0, (points[1] - points[0]) @ before) * before
            after = np.copysign(1.0, (points[-1] - points[-2]) @ after) * after
        return Polyline(points, arc, before, after)

    @property
    def length_m(self) -> float:
        """The length of the path."""
        return float(self.arc_m[-1])

    def follow(
        self, positions: FloatArray, start_m: float, start_distance_m: float = 0.0
    ) -> tuple[FloatArray, FloatArray]:
        """Where positions (T, 2) that follow each other are: along the path (T,), metres, and across it (T,), left is
        positive.

        The first is looked for around ``start_m``, ``start_distance_m`` further than `SEARCH_M` to both sides, each
        other one around the one before. Before the path along is negative, and after it greater than its length.
        """
        along, across = np.empty(len(positions)), np.empty(len(positions))
        moved = np.concatenate([[start_distance_m], np.linalg.norm(np.diff(positions, axis=0), axis=-1)])
        place = start_m
        for index, position in enumerate(positions):
            place, across[index] = self._nearest(position, place, float(moved[index]) + SEARCH_M)
            along[index] = place
        return along, across

    @cached_property
    def _segments(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
        """Starts (N + 1, 2), unit directions (N + 1, 2), arc lengths of the starts, and least and greatest distances
        from the starts (N + 1,): the line before the path, its N - 1 segments, the line after it."""
        lengths = np.diff(self.arc_m)
        units = np.diff(self.points, axis=0) / lengths[:, None]
        return (
            np.concatenate([self.points[:1], self.points]),
            np.concatenate([self.before[None], units, self.after[None]]),
            np.concatenate([self.arc_m[:1], self.arc_m]),
            np.concatenate([[-np.inf], np.zeros(len(lengths) + 1)]),
            np.concatenate([[0.0], lengths, [np.inf]]),
        )

    def _nearest(self, position: FloatArray, around_m: float, search_m: float) -> tuple[float, float]:
        """Where along and across the path its nearest point to a position (2,) is, among those at most about
        ``search_m`` from ``around_m``."""
        first = int(np.searchsorted(self.arc_m, around_m - search_m, side="right"))
        last = int(np.searchsorted(self.arc_m, around_m + search_m, side="left"))
        window = slice(min(first, len(self.arc_m)), max(last, first) + 1)
        starts, units, arcs, lows, highs = (values[window] for values in self._segments)
        offset = position - starts
        on = np.clip((offset * units).sum(-1), lows, highs)
        squared = ((offset - on[:, None] * units) ** 2).sum(-1)
        best = int(np.argmin(squared))
        left = units[best, 0] * offset[best, 1] - units[best, 1] * offset[best, 0]
        return float(arcs[best] + on[best]), float(np.copysign(np.sqrt(squared[best]), left))


def distance_to_segments(points: FloatArray, line: FloatArray) -> FloatArray:
    """Distances (N,) of points (N, 2) from the line through points (K, 2), K >= 1, its ends not continued."""
    start, along = line[:-1], np.diff(line, axis=0)
    if not len(start):
        return np.asarray(np.linalg.norm(points - line[0], axis=-1))
    squared = np.maximum((along * along).sum(-1), 1e-18)
    offset = points[:, None] - start
    on = np.clip((offset * along).sum(-1) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - on[..., None] * along, axis=-1).min(1))
