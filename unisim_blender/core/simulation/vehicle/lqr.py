"""The control that follows a plan: linear-quadratic regulators along the path and across it, as nuPlan's tracker has them.

Along: distance, speed and acceleration follow the plan's schedule. Across: the distance from the path to its left, the heading
beside the path's and the steering angle, linear about the path's curvature at the speeds that the first regulator foresees
(nuPlan devkit, `planning/simulation/controller/tracker/lqr.py`; here with the lags of the vehicle, the gains of a Riccati
iteration and the plan's curvature ahead). Both are exact for a control that is held over a step.

The iteration minimises the sum over stages of ``(x' - r)^T Q (x' - r) + R (u - w)^2`` with ``x' = A x + B u + g`` (Anderson and
Moore, "Optimal Control: Linear Quadratic Methods", 1990, chapters 2 and 4). The cost-to-go is updated in Joseph's form, which
keeps it symmetric and not negative.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry import FloatArray
from ...world.polyline import Polyline
from ..states import EgoState
from .actions import Control, Plan, check_microseconds, check_state
from .parameters import Vehicle

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
        projection = self._line.project(x_m, y_m, near_m)
        return projection.along_m, projection.left_m

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
    corners, part = _on_the_path(x, y, heading)
    path = _curve(x[corners], y[corners], heading[corners])
    nodes = path.distance_m[::PIECES]
    at = np.searchsorted(corners, np.arange(len(x)), "right") - 1
    distance = np.maximum.accumulate(nodes[at] + part)
    if speed is None:
        speed = _speeds(times, distance, state.speed_m_s if begins_here else None)
    fastest = max(float(speed[-1]), state.speed_m_s)
    return Reference(_continued(path, max(fastest * ahead_s, TAIL_M)), times, distance, speed)


def _on_the_path(x: FloatArray, y: FloatArray, heading: FloatArray) -> tuple[list[int], FloatArray]:
    """Which poses make the path, and how far (T,) every pose is ahead of the last of them."""
    corners, part = [0], np.zeros(len(x))
    for i in range(1, len(x)):
        last = corners[-1]
        middle = (heading[last] + heading[i]) / 2
        ahead = (x[i] - x[last]) * math.cos(middle) + (y[i] - y[last]) * math.sin(middle)
        if ahead >= SPACING_M:
            corners.append(i)
        else:
            part[i] = max(ahead, 0.0)
    return corners, part


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


@dataclass(frozen=True, eq=False)
class RegulatorStage:
    """One step of a system with n states: a (n, n), b (n,), g (n,); what the state after it should be, r (n,), at the cost
    q (n,), the diagonal of Q; what the input should be, w, at the cost ``cost``."""

    a: FloatArray
    b: FloatArray
    g: FloatArray
    q: FloatArray
    r: FloatArray
    cost: float
    w: float


@dataclass(frozen=True, eq=False)
class Feedback:
    """The best input of a stage: ``-gain @ x - offset``."""

    gain: FloatArray
    offset: float

    def input(self, x: FloatArray) -> float:
        """Return the input for a state (n,)."""
        return float(-self.gain @ x - self.offset)


def feedbacks(stages: Sequence[RegulatorStage]) -> list[Feedback]:
    """Return the best input of every stage, from the last one backwards."""
    n = len(stages[-1].b)
    p, linear, backward = np.zeros((n, n)), np.zeros(n), []
    for stage in reversed(stages):
        p = p + np.diag(stage.q)
        linear = linear - stage.q * stage.r
        weight = p @ stage.b
        scale = stage.cost + weight @ stage.b
        gain = (weight @ stage.a) / scale
        offset = float((weight @ stage.g + linear @ stage.b - stage.cost * stage.w) / scale)
        backward.append(Feedback(gain, offset))
        a, g = stage.a - stage.b[:, None] * gain, stage.g - stage.b * offset
        linear = a.T @ (p @ g + linear) + gain * (stage.cost * (offset + stage.w))
        p = a.T @ p @ a + gain[:, None] * gain * stage.cost
    return backward[::-1]


STEP_US = 100_000
"""How long a control is held, unless told otherwise."""
STAGES_S = (*[0.1] * 5, *[0.2] * 5, *[0.5] * 3)
"""The horizon: stages after the step for which the control is held. Each costs in proportion to its length."""
DISTANCE_M, SPEED_M_S, ACCELERATION_M_S2 = 1.0, 1.0, 1.0
"""Deviations along the path that cost the same (Bryson's rule)."""
LATERAL_M, HEADING_RAD, STEERING_RAD, LATERAL_M_S2 = 0.4, 0.2, 0.3, 1.5
"""The same across it; a steering angle also counts by the lateral acceleration that it causes."""
MOST_BEHIND_M = 2.5
"""A vehicle that is farther from its place along the path catches up, or falls back, as if it were so far."""
MOST_APPROACH_RAD, MOST_APPROACH_M_S = 0.5, 2.0
"""A vehicle beside the path returns at this angle and this lateral speed at most."""
MOST_HEADING_RAD = 1.0
"""A heading farther from the path's is corrected as this one: the regulator is linear."""
STANDING_M_S = 0.1
"""A plan that is slower for a second is one of standing still."""
STANDING_M = 0.5
"""Distance from its place within which a vehicle stands there."""
HOLD_M_S2 = 4.0
"""How a vehicle without a plan brakes: the most that passengers of nuPlan's limits find comfortable."""
RELEASE_S = 0.5
LEAST_HOLD_M_S2 = 0.5
"""Over the last metre a second it brakes by its speed over so many seconds, and by so much at least, until it stands."""


def track(plan: Plan, state: EgoState, vehicle: Vehicle, time_us: int, step_us: int = STEP_US) -> Control:
    """Return the control that follows a plan from ``time_us`` on, to be held for ``step_us``.

    A plan that begins later is approached from where the vehicle is. After its last pose, the vehicle goes on as the plan turned
    there and brakes to a stop. The vehicle never goes backwards: where the plan is behind it, it waits. Raises `SimulationError`
    for a state that is not finite or a time that is no whole number.
    """
    check_state(state)
    time_us = check_microseconds(time_us, "time_us", -(1 << 62))
    durations_s = np.array([check_microseconds(step_us, "step_us", 1) / 1e6, *STAGES_S])
    times_s = np.append(0.0, np.cumsum(durations_s))
    reference = reference_of(plan, state, time_us, float(times_s[-1]))
    expected_m = float(reference.distance_at(np.zeros(1))[0])
    at_m, left_m = reference.path.project(state.x_m, state.y_m, expected_m)
    if time_us >= plan.times_us[-1] or _is_to_stand(reference, state, expected_m - at_m):
        acceleration = -min(max(state.speed_m_s / RELEASE_S, LEAST_HOLD_M_S2), HOLD_M_S2)
        speeds = np.maximum(state.speed_m_s + acceleration * times_s, 0.0)
    else:
        acceleration, speeds = _along(reference, state, vehicle, at_m, times_s)
    steering = _across(reference.path, state, vehicle, at_m, left_m, durations_s, speeds)
    return Control(acceleration, steering)


def _is_to_stand(reference: Reference, state: EgoState, behind_m: float) -> bool:
    fastest = float(reference.speed_at(np.linspace(0.0, 1.0, 11)).max())
    return max(fastest, state.speed_m_s) <= STANDING_M_S and behind_m <= STANDING_M


def _along(
    reference: Reference, state: EgoState, vehicle: Vehicle, at_m: float, times_s: FloatArray
) -> tuple[float, FloatArray]:
    """The acceleration to ask for, and the speeds (T,) at ``times_s`` (T,) that it leads to."""
    distances, speeds = reference.distance_at(times_s), reference.speed_at(times_s)
    # distances from a place that is not too far ahead or behind
    start = min(max(at_m, float(distances[0]) - MOST_BEHIND_M), float(distances[0]) + MOST_BEHIND_M)
    costs = np.array([DISTANCE_M, SPEED_M_S, math.inf]) ** -2.0
    stages = []
    for i, duration_s in enumerate(np.diff(times_s).tolist()):
        left, once, twice = _lagging(duration_s, vehicle.acceleration_lag_s)
        stages.append(
            RegulatorStage(
                a=np.array([[1.0, duration_s, twice], [0.0, 1.0, once], [0.0, 0.0, left]]),
                b=np.array([duration_s**2 / 2 - twice, duration_s - once, 1 - left]),
                g=np.zeros(3),
                q=costs * duration_s,
                r=np.array([distances[i + 1] - start, speeds[i + 1], 0.0]),
                cost=ACCELERATION_M_S2**-2.0 * duration_s,
                w=float(speeds[i + 1] - speeds[i]) / duration_s,
            )
        )
    x = np.array([0.0, state.speed_m_s, state.acceleration_m_s2])
    low, high = -vehicle.max_deceleration_m_s2, vehicle.max_acceleration_m_s2
    asked, foreseen = [], [state.speed_m_s]
    for stage, feedback in zip(stages, feedbacks(stages), strict=True):
        asked.append(min(max(feedback.input(x), low), high))
        x = stage.a @ x + stage.b * asked[-1]
        x[1] = max(x[1], 0.0)
        foreseen.append(float(x[1]))
    return asked[0], np.array(foreseen)


def _across(
    path: ReferencePath,
    state: EgoState,
    vehicle: Vehicle,
    at_m: float,
    left_m: float,
    durations_s: FloatArray,
    speeds: FloatArray,
) -> float:
    """The steering angle to ask for, of a vehicle that is ``left_m`` beside the path at ``at_m``, at speeds (T + 1,) before and
    after stages (T,)."""
    mean = (speeds[:-1] + speeds[1:]) / 2
    distances = at_m + np.append(0.0, np.cumsum(mean * durations_s))
    # over half a metre more at both ends: headings tell of no curvature where the vehicle stands
    low, high = distances[:-1] - 0.5, distances[1:] + 0.5
    curvatures = (path.heading_at(high) - path.heading_at(low)) / (high - low)
    limit = vehicle.max_steering_rad
    angles = np.clip(np.arctan(vehicle.wheelbase_m * curvatures), -limit, limit)
    costs = np.array([LATERAL_M, HEADING_RAD, math.inf]) ** -2.0
    stages = []
    for duration_s, v, angle in zip(durations_s.tolist(), mean.tolist(), angles.tolist(), strict=True):
        left, once, twice = _lagging(duration_s, vehicle.steering_lag_s)
        # a change of the angle turns the vehicle so fast
        turning = v * (1 + math.tan(angle) ** 2) / vehicle.wheelbase_m
        half = duration_s**2 / 2
        stages.append(
            RegulatorStage(
                a=np.array([[1.0, v * duration_s, v * turning * twice], [0.0, 1.0, turning * once], [0.0, 0.0, left]]),
                b=np.array([v * turning * (half - twice), turning * (duration_s - once), 1 - left]),
                g=np.array([-v * turning * half * angle, -turning * duration_s * angle, 0.0]),
                q=costs * duration_s,
                r=np.zeros(3),
                cost=(STEERING_RAD**-2.0 + (v * turning / LATERAL_M_S2) ** 2) * duration_s,
                w=angle,
            )
        )
    first = feedbacks(stages)[0]
    beside = state.heading_rad - float(path.heading_at(np.array([at_m]))[0])
    heading = min(max(math.remainder(beside, 2 * math.pi), -MOST_HEADING_RAD), MOST_HEADING_RAD)
    by_distance, by_heading, _ = first.gain.tolist()
    if by_distance > 0:
        approach = min(MOST_APPROACH_RAD, MOST_APPROACH_M_S / max(state.speed_m_s, 1e-3))
        most = approach * by_heading / by_distance
        left_m = min(max(left_m, -most), most)
    asked = first.input(np.array([left_m, heading, state.steering_rad]))
    return min(max(asked, -limit), limit)


def _lagging(duration_s: float, lag_s: float) -> tuple[float, float, float]:
    """Return the share of a lagged value that remains after a duration, and its first and second integral over the
    duration."""
    left = math.exp(-duration_s / lag_s) if lag_s else 0.0
    once = lag_s * (1 - left)
    return left, once, lag_s * (duration_s - once)
