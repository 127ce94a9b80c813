"""Maneuvers: motion of an actor from a few numbers, with bounded accelerations and smooth joins.

A `DrivenPath` is a trajectory as a smooth path, and the arc length along it over time. A maneuver is a course, the actor's
own or the ego vehicle's, with another arc length over time and a distance to its left. Lateral motion is a quintic
polynomial of the arc length, so that the heading follows the path at every speed, and longitudinal motion one of time
(minimum jerk; Flash and Hogan 1985, Werling et al. 2010).
"""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from ...geometry import FloatArray, Trajectory, quaternion_from_yaw, quaternion_product
from ...world.drive import Actor, Drive
from ..checks import fail, require
from ..context import EditContext, current, with_actor
from ..edit import Edit
from ..types import Scenario
from .paths import arc_lengths, arc_lengths_of, path_of, points_along

STEP_S, STEP_M = 0.1, 0.5
"""Between samples of a course in time, and between vertices of its path."""
SMOOTH_S, SMOOTH_M = 0.35, 1.5
"""Standard deviations of the Gaussians that smooth a course in time, and its path along its length."""
LEAST_M, LEAST_M_S = 2.0, 0.5
"""What goes less far has no course; what is slower has no maneuver."""
WANDER_M = 0.05
"""What stands, and is annotated so far from where it stands, goes nowhere."""
SPEED_S = 0.2
"""Half of the time over which a speed is taken."""
FADE_S, FADE_M = 1.6, 8.0
"""Time, and length at least, over which the difference between a trajectory and its smooth course fades at the start of a
maneuver. What stands stays where it is."""
STEEPEST, LATERAL_M_S2 = 0.35, 1.5
"""Largest slope of a path to the lane that is left, and lateral acceleration, by default."""
FASTER_M_S2, SLOWER_M_S2 = 2.5, 3.5
"""Largest acceleration and deceleration of an actor that goes to a place in time."""
RAMP_S = 0.4
"""Time in which a deceleration begins and ends."""
FRONT_M = 3.9
"""From the rear axle of the ego vehicle to its front bumper, where a scenario's `simulation` does not say."""


def ease(share: FloatArray) -> FloatArray:
    """Return a smooth step from 0 to 1 (...) over shares (...) of 0 to 1: a quintic whose slope and curvature are 0 at
    both ends."""
    u = np.clip(share, 0.0, 1.0)
    return np.asarray(u**3 * (10 - 15 * u + 6 * u**2))


@dataclass(frozen=True)
class Quintic:
    """The polynomial on 0 to ``length`` with a value, a slope and a second derivative at each end."""

    start: tuple[float, float, float]
    end: tuple[float, float, float]
    length: float

    def at(self, places: FloatArray | float, order: int = 0) -> FloatArray:
        """Return its values (...) at places (...), or those of a derivative."""
        (x0, v0, a0), (x1, v1, a1), t = self.start, self.end, self.length
        x, v, a = x1 - x0 - v0 * t - a0 * t**2 / 2, v1 - v0 - a0 * t, a1 - a0
        cubic = (10 * x - 4 * v * t + a * t**2 / 2) / t**3
        quartic, last = (-15 * x + 7 * v * t - a * t**2) / t**4, (6 * x - 3 * v * t + a * t**2 / 2) / t**5
        factors = np.array([x0, v0, a0 / 2, cubic, quartic, last])
        for _ in range(order):
            factors = factors[1:] * np.arange(1, len(factors))
        return np.asarray(np.asarray(places, float)[..., None] ** np.arange(len(factors)) @ factors)


def smoothed(values: FloatArray, deviation: float) -> FloatArray:
    """Return evenly spaced values (N, ...) convolved with a Gaussian, its deviation in samples. Lines stay as they are,
    up to both ends."""
    half = min(int(np.ceil(3 * deviation)), len(values) - 1)
    weights = np.exp(-((np.arange(-half, half + 1) / deviation) ** 2) / 2)
    ends = 2 * values[:1] - values[half:0:-1], 2 * values[-1:] - values[-2 : -half - 2 : -1]
    padded = np.concatenate([ends[0], values, ends[1]]) if half else values
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1, axis=0)
    return np.asarray(windows @ (weights / weights.sum()))


@dataclass(frozen=True)
class DrivenPath:
    """A smooth path, vertices (V, 3) at arc lengths (V,) with headings (V,) in radians, and the arc lengths (N,) at which
    something is at times (N,)."""

    times_s: FloatArray
    gone_m: FloatArray
    along_m: FloatArray
    points: FloatArray
    headings: FloatArray

    @staticmethod
    def of(trajectory: Trajectory) -> DrivenPath | None:
        """Return the course of a trajectory; None where it goes nowhere."""
        first, last = trajectory.times_s[0], trajectory.times_s[-1]
        times = np.linspace(first, last, 1 + max(1, int(np.ceil((last - first) / STEP_S))))
        places = smoothed(trajectory.positions_at(times), SMOOTH_S / STEP_S)
        vertices, along = path_of(places)
        if along[-1] < LEAST_M:
            return None
        rest = float(np.linalg.norm(places[-1] - places[vertices[-1]]))
        if rest > WANDER_M:
            vertices, along = np.append(vertices, len(places) - 1), np.append(along, along[-1] + rest)
        gone = smoothed(np.maximum.accumulate(arc_lengths(places, vertices, along)), SMOOTH_S / STEP_S)
        even = np.linspace(0.0, along[-1], 1 + int(along[-1] / STEP_M))
        points = np.stack([np.interp(even, along, column) for column in places[vertices].T], -1)
        points = smoothed(points, SMOOTH_M / STEP_M)
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        ahead = np.gradient(points, lengths, axis=0)
        headings = np.unwrap(np.arctan2(ahead[:, 1], ahead[:, 0]))
        return DrivenPath(times, gone * lengths[-1] / along[-1], lengths, points, headings)

    def gone(self, times_s: FloatArray | float) -> FloatArray:
        """Return the arc lengths (...) at times (...): on at the speeds of both ends beyond them."""
        times = np.asarray(times_s, float)
        inside = np.interp(times, self.times_s, self.gone_m)
        for end, beyond in ((0, np.minimum(times - self.times_s[0], 0)), (-1, np.maximum(times - self.times_s[-1], 0))):
            inside = inside + beyond * self.speed(self.times_s[end]) if beyond.any() else inside
        return np.asarray(inside)

    def speed(self, times_s: FloatArray | float) -> FloatArray:
        """Return the speeds (...) at times (...)."""
        low, high = (np.clip(np.asarray(times_s) + by, *self.times_s[[0, -1]]) for by in (-SPEED_S, SPEED_S))
        low, high = np.minimum(low, self.times_s[-1] - SPEED_S), np.maximum(high, self.times_s[0] + SPEED_S)
        gone = np.interp(high, self.times_s, self.gone_m) - np.interp(low, self.times_s, self.gone_m)
        return np.asarray(np.maximum(gone / (high - low), 0.0))

    def beside(self, gone_m: FloatArray, left_m: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray]:
        """Return places (N, 3) and headings (N,) at arc lengths (N,), straight on beyond the path's ends, so far to its
        left (N,)."""
        headings = np.interp(gone_m, self.along_m, self.headings)
        places = points_along(self.points, self.along_m, gone_m)
        left = np.stack([-np.sin(headings), np.cos(headings), np.zeros_like(headings)], -1)
        return places + left * np.broadcast_to(left_m, headings.shape)[:, None], headings

    def nearest(self, place: FloatArray) -> tuple[float, float, float]:
        """Return the arc length next to a place (3,), and how far the place is to the left of the path there and
        above it."""
        gone = arc_lengths_of(self.points, place[None])
        (there,), (heading,) = self.beside(gone)
        apart = place - there
        return float(gone[0]), float(apart[1] * np.cos(heading) - apart[0] * np.sin(heading)), float(apart[2])


def joined(actor: Actor, since_s: float, times_s: FloatArray, places: FloatArray, headings: FloatArray) -> Trajectory:
    """Return an actor's trajectory that goes through places (N, 3) with headings (N,) at times (N,) from ``since_s``, the
    first of them, on; what it is apart from them then fades."""
    base = actor.world_from_actor
    gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(places, axis=0), axis=1)))
    speed = gone[1:2].sum() / max(float(np.diff(times_s[:2]).sum()), 1e-6)
    here, fade = base.at(since_s), 1 - ease(gone / max(FADE_S * speed, FADE_M))
    yaw = np.arctan2(here[1, 0], here[0, 0])
    turned = (yaw - headings[0] + np.pi) % (2 * np.pi) - np.pi
    backward = np.pi * np.sign(turned) if abs(turned) > np.pi / 2 else 0.0  # a box that is annotated so stays so
    tilt = quaternion_product(quaternion_from_yaw(-yaw), base.placed_at(since_s)[1])
    turns = quaternion_from_yaw(headings + backward + fade * (turned - backward))
    before = base.times_s < since_s - 1e-9
    return Trajectory(
        np.concatenate([base.times_s[before], times_s]),
        np.concatenate([base.positions[before], places + fade[:, None] * (here[:3, 3] - places[0])]),
        np.concatenate([base.quaternions_wxyz[before], quaternion_product(turns, tilt)]),
    )


def throughout(times_s: FloatArray, places: FloatArray, headings: FloatArray) -> Trajectory:
    """Return a trajectory through places (N, 3) with headings (N,) at times (N,), level."""
    return Trajectory(times_s, places, quaternion_from_yaw(headings))


@dataclass(frozen=True)
class Maneuver(Edit):
    """New motion of an actor from a few numbers."""

    seen_by = "maneuvers"

    actor: str

    @abstractmethod
    def motion(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> Trajectory:
        """Return the actor's trajectory. Raises `ScenarioError` where there is none that is plausible."""

    def window(self, actor: Actor, drive: Drive, place: str, context: EditContext) -> tuple[float, float]:
        """Return when the actor is present (start, end), in seconds: as before."""
        return actor.start_s, actor.end_s

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        actor = current(drive, self.actor, f"{place}.actor", context)
        trajectory = self.motion(actor, drive, place, context)
        start, end = self.window(actor, drive, place, context)
        return with_actor(drive, replace(actor, world_from_actor=trajectory, start_s=start, end_s=end, is_moving=True))


def own_course(actor: Actor, time_s: float, place: str) -> DrivenPath:
    """Return the course of an actor that goes somewhere at a time. Raises `ScenarioError`."""
    course = DrivenPath.of(actor.world_from_actor)
    if course is None or course.speed(time_s) < LEAST_M_S:
        fail(f"{place}.at_s", f'"{actor.uid}" stands at {time_s:g} s: this needs an actor that moves')
    require(
        actor.start_s <= time_s <= actor.end_s,
        f"{place}.at_s",
        f'"{actor.uid}" is there from {actor.start_s:.2f} to {actor.end_s:.2f} s, not at {time_s:g} s',
    )
    return course


def ego_course(drive: Drive, place: str) -> DrivenPath:
    """Return the course of the ego vehicle. Raises `ScenarioError` where it goes nowhere."""
    course = DrivenPath.of(drive.world_from_ego)
    if course is None:
        fail(place, "the ego vehicle stands throughout, so it has no path that something could be on")
    return course


def ego_front_m(scenario: Scenario) -> float:
    """Return how far in front of the origin of the ego frame the vehicle's bumper is, in metres."""
    vehicle = (scenario.simulation.vehicle if scenario.simulation is not None else None) or {}
    length, overhang = vehicle.get("length_m", FRONT_M + 1.0), vehicle.get("rear_overhang_m", 1.0)
    return float(vehicle.get("rear_axle_m", (0.0,))[0] + length - overhang)


def frame_times(context: EditContext, since_s: float | None = None) -> FloatArray:
    """Return the times (N,) of the log's frames, of those after ``since_s`` with that one first."""
    times = np.array(sorted(context.recorded.time_s.values()))
    return times if since_s is None else np.append(since_s, times[times > since_s + 1e-6])


def needed_m(left_m: float, speed_m_s: float) -> float:
    """Return the length of a comfortable path to another lane."""
    steep, curved = 1.875 * abs(left_m) / STEEPEST, 5.774 * abs(left_m) / LATERAL_M_S2  # extrema of `ease`
    return float(max(steep, speed_m_s * np.sqrt(curved), STEP_M))


def too_late(place: str, what: str, needed_s: float, left_s: float) -> NoReturn:
    """Raise `ScenarioError` for a maneuver that would not end in time."""
    fail(f"{place}.at_s", f"{what} takes {needed_s:.1f} s, and {max(left_s, 0.0):.1f} s are left: begin earlier")
