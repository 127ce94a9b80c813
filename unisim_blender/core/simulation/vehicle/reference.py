"""A plan as a path and a schedule: where it leads, and how far along it the vehicle is to be when."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry import FloatArray
from ...world.polyline import Polyline
from ..states import EgoState
from .actions import Plan

SPACING_M = 0.5
"""Poses of a path are so far apart at least: jitter of a standing vehicle's poses is no path."""
PIECES = 8
"""Straight pieces of a path between two poses."""
BEFORE_M = 1000.0
"""A path is carried on straight so far before its first pose."""
TAIL_M = 2.0
"""Over so much of its end a path's curvature is that of its continuation."""
TAIL_TURN_RAD = math.pi / 2
"""The continuation turns so far at most, and is straight from there."""
TAIL_PIECES = 100


@dataclass(frozen=True, eq=False)
class ReferencePath:
    """A curve in the plane as points (M,) by ``distance_m``, which is 0 at its first pose; headings do not wrap."""

    distance_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray

    def project(self, x_m: float, y_m: float, near_m: float) -> tuple[float, float]:
        """Return how far along the path its nearest point is, and how far to the left of the path (x, y) lies. Of several
        parts of the path that pass there, the one near ``near_m`` is taken."""
        found = self._line.project(x_m, y_m, near_m)
        return found.along_m, found.left_m

    @cached_property
    def _line(self) -> Polyline:
        return Polyline(np.stack([self.x_m, self.y_m], -1), self.distance_m)

    def heading_at(self, distance_m: FloatArray) -> FloatArray:
        """Return headings (...) at distances (...)."""
        return np.interp(distance_m, self.distance_m, self.heading_rad)


@dataclass(frozen=True, eq=False)
class Reference:
    """A path, and the distances along it and speeds (T,) at times (T,), seconds from now."""

    path: ReferencePath
    times_s: FloatArray
    distance_m: FloatArray
    speed_m_s: FloatArray

    def speed_at(self, times_s: FloatArray) -> FloatArray:
        """Return speeds (...) at times (...): linear between poses, and constant beyond them."""
        return np.interp(times_s, self.times_s, self.speed_m_s)

    def distance_at(self, times_s: FloatArray) -> FloatArray:
        """Return distances (...) at times (...): cubic between poses by their speeds, and at a constant speed beyond them."""
        t, s, v = self.times_s, self.distance_m, self.speed_m_s
        beyond = np.where(times_s > t[-1], (times_s - t[-1]) * v[-1], np.minimum(times_s - t[0], 0.0) * v[0])
        if len(t) == 1:
            return np.asarray(s[0] + beyond)
        inside = np.clip(times_s, t[0], t[-1])
        i = np.clip(np.searchsorted(t, inside, "right") - 1, 0, len(t) - 2)
        span = t[i + 1] - t[i]
        u = (inside - t[i]) / span
        cubic = (
            (1 + 2 * u) * (1 - u) ** 2 * s[i] + u * u * (3 - 2 * u) * s[i + 1]
            + u * (1 - u) * span * ((1 - u) * v[i] - u * v[i + 1])
        )  # fmt: skip
        return np.asarray(cubic + beyond)


def reference_of(plan: Plan, state: EgoState, time_us: int, ahead_s: float) -> Reference:
    """Return the reference of a plan at a time. The path goes on ``ahead_s`` beyond the plan's end, as it turns there.

    A plan whose first pose is still to come begins with the vehicle as it is. A pose that is not ahead of those before it is
    waited at: no path leads backwards.
    """
    times = (plan.times_us - time_us) / 1e6
    x, y, heading, speed = plan.x_m, plan.y_m, plan.heading_rad, plan.speed_m_s
    begins_here = bool(times[0] > 0)
    if begins_here:
        times, x, y = np.append(0.0, times), np.append(state.x_m, x), np.append(state.y_m, y)
        heading = np.append(state.heading_rad, heading)
        speed = None if speed is None else np.append(state.speed_m_s, speed)
    heading = np.unwrap(heading)
    kept, part = _on_the_path(x, y, heading)
    path = _curve(x[kept], y[kept], heading[kept])
    nodes = path.distance_m[::PIECES]
    at = np.searchsorted(kept, np.arange(len(x)), "right") - 1
    distance = np.maximum.accumulate(nodes[at] + part)
    if speed is None:
        speed = _speeds(times, distance, state.speed_m_s if begins_here else None)
    fastest = max(float(speed[-1]), state.speed_m_s)
    return Reference(_continued(path, max(fastest * ahead_s, TAIL_M)), times, distance, speed)


def _on_the_path(x: FloatArray, y: FloatArray, heading: FloatArray) -> tuple[list[int], FloatArray]:
    """Which poses make the path, and how far (T,) every pose is ahead of the last of them."""
    kept, part = [0], np.zeros(len(x))
    for i in range(1, len(x)):
        last = kept[-1]
        middle = (heading[last] + heading[i]) / 2
        ahead = (x[i] - x[last]) * math.cos(middle) + (y[i] - y[last]) * math.sin(middle)
        if ahead >= SPACING_M:
            kept.append(i)
        else:
            part[i] = max(ahead, 0.0)
    return kept, part


def _curve(x: FloatArray, y: FloatArray, heading: FloatArray) -> ReferencePath:
    """The path through poses (K,): cubic between two, which an arc is to 1e-4 of its radius up to a quarter turn."""
    if len(x) == 1:
        return ReferencePath(np.zeros(1), x, y, heading)
    dx, dy = np.diff(x)[:, None], np.diff(y)[:, None]
    turn = np.clip(np.diff(heading), -math.pi, math.pi)[:, None]
    # the length of an arc's tangents in Hermite's form
    tangent = np.hypot(dx, dy) / np.cos(turn / 4) ** 2
    c, s = np.cos(heading)[:, None], np.sin(heading)[:, None]
    u = np.arange(PIECES) / PIECES
    rise, leave, arrive = u * u * (3 - 2 * u), u * (1 - u) ** 2, -u * u * (1 - u)
    px = x[:-1, None] + dx * rise + tangent * (c[:-1] * leave + c[1:] * arrive)
    py = y[:-1, None] + dy * rise + tangent * (s[:-1] * leave + s[1:] * arrive)
    rise, leave, arrive = 6 * u * (1 - u), (1 - u) * (1 - 3 * u), u * (3 * u - 2)
    vx = dx * rise + tangent * (c[:-1] * leave + c[1:] * arrive)
    vy = dy * rise + tangent * (s[:-1] * leave + s[1:] * arrive)
    px, py = np.append(px.ravel(), x[-1]), np.append(py.ravel(), y[-1])
    along = np.unwrap(np.append(np.arctan2(vy, vx).ravel(), heading[-1]))
    distance = np.append(0.0, np.cumsum(np.hypot(np.diff(px), np.diff(py))))
    return ReferencePath(distance, px, py, along)


def _speeds(times: FloatArray, distance: FloatArray, first: float | None) -> FloatArray:
    """Speeds (T,) at poses: between the mean speeds before and after, and carried on at the ends."""
    if len(times) == 1:
        return np.zeros(1)
    mean, middle = np.diff(distance) / np.diff(times), (times[:-1] + times[1:]) / 2
    if len(mean) == 1:
        ends = [mean[0], mean[0]] if first is None else [first, min(max(2 * mean[0] - first, 0.0), 2 * mean[0])]
        return np.array(ends)
    speeds = np.interp(times, middle, mean)
    for end, a, b in ((0, 0, 1), (-1, -1, -2)):
        slope = (mean[b] - mean[a]) / (middle[b] - middle[a])
        speeds[end] = min(max(mean[a] + slope * (times[end] - middle[a]), 0.0), 2 * mean[a])
    if first is not None:
        speeds[0] = first
    return speeds


def _continued(path: ReferencePath, length_m: float) -> ReferencePath:
    """The path, straight before its first pose, and with its last curvature behind its end."""
    s, x, y, heading = path.distance_m, path.x_m, path.y_m, path.heading_rad
    start = max(int(np.searchsorted(s, s[-1] - TAIL_M, "right")) - 1, 0)
    curvature = (heading[-1] - heading[start]) / (s[-1] - s[start]) if s[-1] > s[start] else 0.0
    piece = length_m / TAIL_PIECES
    along = piece * np.arange(1, TAIL_PIECES + 1)
    turned = heading[-1] + np.clip(curvature * along, -TAIL_TURN_RAD, TAIL_TURN_RAD)
    middle = heading[-1] + np.clip(curvature * (along - piece / 2), -TAIL_TURN_RAD, TAIL_TURN_RAD)
    return ReferencePath(
        np.concatenate([[s[0] - BEFORE_M], s, s[-1] + along]),
        np.concatenate([[x[0] - BEFORE_M * math.cos(heading[0])], x, x[-1] + piece * np.cumsum(np.cos(middle))]),
        np.concatenate([[y[0] - BEFORE_M * math.sin(heading[0])], y, y[-1] + piece * np.cumsum(np.sin(middle))]),
        np.concatenate([[heading[0]], heading, turned]),
    )
