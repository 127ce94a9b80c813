"""Braking at a constant deceleration: how fast actors of each class move and brake, the way to a stop at the end of a
line, and a stop on a trajectory that goes on afterwards."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...core.actor_images.names import group_of
from ...core.geometry import FloatArray
from ..sampled.clock import Clock
from .keys import SAME_FRAME, TrajectoryKeys, extended
from .kinematics import motion_of


@dataclass(frozen=True)
class Habits:
    """How actors of a class move: usual speed, comfortable and emergency deceleration."""

    speed_m_s: float
    comfortable_m_s2: float
    emergency_m_s2: float


HABITS = {
    "CAR": Habits(8.0, 2.0, 5.5),
    "TRUCK": Habits(8.0, 1.2, 5.0),
    "CYCLE": Habits(5.0, 1.5, 4.0),
    "PERSON": Habits(1.4, 1.0, 3.0),
    "OTHER": Habits(1.4, 1.0, 3.0),
}
"""By the group of a class. Cars brake as nuPlan's drivers do, and in an emergency a little less than the limit of
motion; 5 m/s² is what UN Regulation 13 asks of trucks' and buses' brakes."""


def habits_of(label: str) -> Habits:
    """Return how actors of a class move."""
    return HABITS[group_of(label)]


@dataclass(frozen=True)
class Approach:
    """The way along a line of a length to its end: at ``speed_m_s``, or slower where the line is too short to brake
    from that, then braking at ``braking_m_s2``."""

    length_m: float
    speed_m_s: float
    braking_m_s2: float

    @property
    def top_m_s(self) -> float:
        """The speed before braking."""
        return float(min(self.speed_m_s, np.sqrt(2 * self.braking_m_s2 * self.length_m)))

    @property
    def duration_s(self) -> float:
        """Time until it stands at the end."""
        return self.length_m / self.top_m_s + self.top_m_s / (2 * self.braking_m_s2)

    def lengths(self, times_s: FloatArray) -> FloatArray:
        """Return how far it has gone (N,) at times (N,) from the start on, in metres."""
        left_s = np.maximum(self.duration_s - times_s, 0.0)
        braking_s = np.minimum(left_s, self.top_m_s / self.braking_m_s2)
        left_m = self.braking_m_s2 * braking_s**2 / 2 + self.top_m_s * (left_s - braking_s)
        return np.asarray(np.clip(self.length_m - left_m, 0.0, self.length_m))


STEPS = 32
"""Steps between two frames, in which braking and speeding up are added up."""
APART_S = 1e-6
"""Time on the trajectory that passes while the actor stands."""


@dataclass(frozen=True)
class StopInMotion:
    """A stop on a trajectory: times on it (K,), and the later times (K,) at which the actor is there instead, both
    rising; from when to when it stands."""

    before_s: FloatArray
    after_s: FloatArray
    stands_s: tuple[float, float]

    def later(self, times_s: FloatArray) -> FloatArray:
        """Return when the actor is where it was at times (...)."""
        return np.asarray(times_s + np.interp(times_s, self.before_s, self.after_s - self.before_s))

    def earlier(self, times_s: FloatArray) -> FloatArray:
        """Return when the actor was where it is at times (...)."""
        return np.asarray(times_s - np.interp(times_s, self.after_s, self.after_s - self.before_s))


def braked(
    keys: TrajectoryKeys, start_s: float, stands_s: float, braking_m_s2: float, start_m_s2: float, clock: Clock
) -> StopInMotion:
    """Return the stop of what brakes from a time on, stands for ``stands_s`` and then speeds up at ``start_m_s2`` until
    it is as fast as its trajectory."""
    times_s = clock.time_s(keys.frames)
    speeds = motion_of(extended(clock.times_s, times_s, keys.positions), clock.times_s).speed_m_s
    speed = float(np.interp(start_s, clock.times_s, speeds))
    until_s = max(times_s[-1], clock.times_s[-1], start_s) + speed / braking_m_s2
    old = np.arange(start_s, until_s + 2 / clock.rate, 1 / clock.rate / STEPS)
    steps = np.linalg.norm(np.diff(extended(old, times_s, keys.positions), axis=0), axis=1)
    gone = np.concatenate([[0.0], np.cumsum(steps)])
    whole = speed**2 / (2 * braking_m_s2)
    stop = min(int(np.searchsorted(gone, whole)), len(old) - 1)
    old = np.concatenate([old[: stop + 1], [old[stop] + APART_S], old[stop + 1 :]])
    before = np.sqrt(2 * np.maximum(gone[stop] - gone[: stop + 1], 0) / braking_m_s2)
    after = np.sqrt(2 * (gone[stop:] - gone[stop]) / start_m_s2)
    takes = np.concatenate([-np.diff(before), [stands_s], np.diff(after)])
    new = start_s + np.concatenate([[0.0], np.cumsum(np.maximum(np.diff(old), takes))])
    return StopInMotion(old, new, (float(new[stop]), float(new[stop + 1])))


def stopped_keys(keys: TrajectoryKeys, stop: StopInMotion, clock: Clock) -> TrajectoryKeys:
    """Return keys of a trajectory with a stop, at the clock's frames too from where it brakes on."""
    times_s = clock.time_s(keys.frames)
    new = np.concatenate([stop.later(times_s), clock.times_s[clock.times_s > stop.after_s[0]], stop.stands_s])
    new = np.unique(np.append(new, stop.after_s[0]))
    new = new[np.concatenate([[True], np.diff(new) > SAME_FRAME / clock.rate])]
    old = stop.earlier(new)
    turns = np.stack([np.interp(old, times_s, column) for column in keys.quaternions.T], -1)
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return TrajectoryKeys(clock.frame(new), extended(old, times_s, keys.positions), turns)
