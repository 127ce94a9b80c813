"""A path in the plane by its arc length, and where points are along and across it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ....geometry import FloatArray

LEAST_SEGMENT_M = 0.05
"""Keys that are nearer to the last one are left out: where the vehicle stands, the noise of its poses is no path."""
END_M = 1.0
"""The direction of an end of the path is that of its last metre."""
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
        """The path through positions (K, 2) in order; the headings are the ends' directions where the path is too
        short to have any."""
        kept = [0]
        for index in range(1, len(positions)):
            if np.hypot(*(positions[index] - positions[kept[-1]])) >= LEAST_SEGMENT_M:
                kept.append(index)
        points = np.asarray(positions[kept], np.float64)
        arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1))])
        ends = []
        for heading, line, sign in ((first_heading_rad, points, 1.0), (last_heading_rad, points[::-1], -1.0)):
            distance = np.linalg.norm(line - line[0], axis=-1)
            far = np.flatnonzero(distance >= END_M)
            along = np.array([np.cos(heading), np.sin(heading)])
            ends.append(sign * (line[far[0]] - line[0]) / distance[far[0]] if len(far) else along)
        return Polyline(points, arc, ends[0], ends[1])

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

    def _nearest(self, position: FloatArray, around_m: float, search_m: float) -> tuple[float, float]:
        """Where along and across the path its nearest point to a position (2,) is, among those at most about
        ``search_m`` from ``around_m``."""
        first = max(int(np.searchsorted(self.arc_m, around_m - search_m, side="right")) - 1, 0)
        last = min(int(np.searchsorted(self.arc_m, around_m + search_m, side="left")), len(self.arc_m) - 1)
        first = min(first, last)
        # the ends are segments of any length: their parameter has one limit alone
        starts, lows, highs, arcs = [self.points[first:last]], [np.zeros(last - first)], [], [self.arc_m[first:last]]
        lengths = np.diff(self.arc_m[first : last + 1])
        units = [np.diff(self.points[first : last + 1], axis=0) / lengths[:, None]]
        highs.append(lengths)
        for reached, end, unit, low, high in (
            (first == 0, 0, self.before, -np.inf, 0.0),
            (last == len(self.arc_m) - 1, -1, self.after, 0.0, np.inf),
        ):
            if reached:
                starts.append(self.points[[end]])
                units.append(unit[None])
                arcs.append(self.arc_m[[end]])
                lows.append(np.array([low]))
                highs.append(np.array([high]))
        start, unit = np.concatenate(starts), np.concatenate(units)
        offset = position - start
        on = np.clip((offset * unit).sum(-1), np.concatenate(lows), np.concatenate(highs))
        distance = np.linalg.norm(offset - on[:, None] * unit, axis=-1)
        best = int(np.argmin(distance))
        left = unit[best, 0] * offset[best, 1] - unit[best, 1] * offset[best, 0]
        return float(np.concatenate(arcs)[best] + on[best]), float(np.copysign(distance[best], left))


def distance_to_segments(points: FloatArray, line: FloatArray) -> FloatArray:
    """Distances (N,) of points (N, 2) from the line through points (K, 2), K >= 1, its ends not continued."""
    start, along = line[:-1], np.diff(line, axis=0)
    if not len(start):
        return np.asarray(np.linalg.norm(points - line[0], axis=-1))
    squared = np.maximum((along * along).sum(-1), 1e-18)
    offset = points[:, None] - start
    on = np.clip((offset * along).sum(-1) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(offset - on[..., None] * along, axis=-1).min(1))
