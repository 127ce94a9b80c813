"""Speeds changed at a constant acceleration: how fast actors of each class move and brake, the way to a stop at the end
of a line; other speeds and a change of speed by hand on a trajectory, along its own path."""

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
APART_M = 1e-9
"""Length of the path that what stands goes at each step, so that times follow from lengths."""


@dataclass(frozen=True)
class TimeChange:
    """Times on a trajectory (K,), and the times (K,) at which the actor is there instead, both rising. ``hardest_m_s2``: by
    how much it brakes or speeds up more than before."""

    before_s: FloatArray
    after_s: FloatArray
    hardest_m_s2: float = 0.0

    def later(self, times_s: FloatArray) -> FloatArray:
        """Return when the actor is where it was at times (...)."""
        return np.asarray(times_s + np.interp(times_s, self.before_s, self.after_s - self.before_s))

    def earlier(self, times_s: FloatArray) -> FloatArray:
        """Return when the actor was where it is at times (...)."""
        return np.asarray(times_s - np.interp(times_s, self.after_s, self.after_s - self.before_s))


LEAST_M_S = 0.1
"""Speed that counts at least where it changes: what stands may go on at any."""
SLOWEST, FASTEST = 0.01, 100.0
"""Factors of the speed that are tried."""
HARDER = 1.1
"""By which factor an acceleration grows until what was asked for is possible."""


def other_speed(
    keys: TrajectoryKeys,
    first_s: float,
    last_s: float | None,
    factor: float,
    braking_m_s2: float,
    start_m_s2: float,
    clock: Clock,
) -> TimeChange:
    """Return the change of what goes ``factor`` times as fast from a time on, or up to ``last_s``, where it is at exactly
    the time that this factor throughout gives; then it goes on as before.

    It brakes and speeds up by these accelerations more than its trajectory does, harder only where it would not be at
    its place in time otherwise.
    """
    times_s = clock.time_s(keys.frames)
    end_s = (
        last_s if last_s is not None else max(times_s[-1], first_s + (clock.times_s[-1] - first_s) * max(factor, 1)) + 1
    )
    old = np.linspace(first_s, end_s, int((end_s - first_s) * clock.rate * STEPS) + 2)
    speeds = motion_of(extended(clock.times_s, times_s, keys.positions), clock.times_s).speed_m_s
    steps = np.diff(old)
    slower = factor < 1
    away_m_s2, back_m_s2 = (braking_m_s2, start_m_s2) if slower else (start_m_s2, braking_m_s2)
    # the square of the rate of time changes by twice the acceleration over the speed: dv = a dt
    gone = np.append(
        0.0, np.cumsum(2 * steps / np.maximum(np.interp((old[1:] + old[:-1]) / 2, clock.times_s, speeds), LEAST_M_S))
    )
    sign, limit, bound = (-1, np.maximum, SLOWEST) if slower else (1, np.minimum, FASTEST)

    def durations(reached: float, harder: float) -> FloatArray:
        squares = limit(1 + sign * harder * away_m_s2 * gone, reached**2)
        if last_s is not None:
            squares = limit(squares, 1 + sign * harder * back_m_s2 * (gone[-1] - gone))
        rates = np.sqrt(squares)
        return np.asarray(2 * steps / (rates[1:] + rates[:-1]))

    reached, harder = factor, 1.0
    if last_s is not None:
        wanted_s = (last_s - first_s) / factor
        while (durations(bound, harder).sum() < wanted_s) == slower and harder < 1e4:
            harder *= HARDER
        low, high = np.log(bound), 0.0
        for _ in range(60):
            reached = float(np.exp((low + high) / 2))
            if (durations(reached, harder).sum() > wanted_s) == slower:
                low = (low + high) / 2
            else:
                high = (low + high) / 2
    new = first_s + np.append(0.0, np.cumsum(durations(reached, harder)))
    return TimeChange(old, new, hardest_m_s2=harder * max(away_m_s2, back_m_s2 if last_s is not None else 0.0))


def changed_keys(keys: TrajectoryKeys, change: TimeChange, clock: Clock) -> TrajectoryKeys:
    """Return keys of a trajectory at other times, at the clock's frames too from where they change on."""
    times_s = clock.time_s(keys.frames)
    new = np.concatenate([change.later(times_s), clock.times_s[clock.times_s > change.after_s[0]]])
    new = np.unique(np.append(new, change.after_s[0]))
    new = new[np.concatenate([[True], np.diff(new) > SAME_FRAME / clock.rate])]
    old = change.earlier(new)
    turns = np.stack([np.interp(old, times_s, column) for column in keys.quaternions.T], -1)
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return TrajectoryKeys(clock.frame(new), extended(old, times_s, keys.positions), turns)


COASTING_M_S = 0.5
"""Speed at the end of a trajectory below which it does not go on beyond it."""


def speed_at(keys: TrajectoryKeys, time_s: float, speed_m_s: float, reach_s: float, clock: Clock) -> TimeChange:
    """Return the change of what has a speed at a time, and less and less of the difference up to ``reach_s`` before and
    after it: a raised cosine is added to the speed, of which the integral is how far it is ahead on its path."""
    times_s = clock.time_s(keys.frames)
    speeds = motion_of(extended(clock.times_s, times_s, keys.positions), clock.times_s).speed_m_s
    start_s, end_s = time_s - reach_s, max(times_s[-1], clock.times_s[-1]) + 1
    new = np.linspace(start_s, end_s, int((end_s - start_s) * clock.rate * STEPS) + 2)
    bell = (1 + np.cos(np.pi * np.clip((new - time_s) / reach_s, -1, 1))) / 2
    now = np.interp(new, clock.times_s, speeds)
    added = np.maximum((speed_m_s - np.interp(time_s, clock.times_s, speeds)) * bell, -now)
    ahead = np.append(0.0, np.cumsum((added[1:] + added[:-1]) / 2 * np.diff(new)))
    ends_s = float(times_s[-1])
    if np.interp(ends_s, clock.times_s, speeds) > COASTING_M_S:
        ends_s = end_s + float(ahead.max()) / COASTING_M_S
    old = np.arange(start_s, ends_s, 1 / clock.rate / STEPS)
    steps = np.linalg.norm(np.diff(extended(old, times_s, keys.positions), axis=0), axis=1)
    gone = np.append(0.0, np.cumsum(steps + APART_M))
    return TimeChange(
        np.interp(np.interp(new, old, gone) + ahead, gone, old) + APART_S * np.arange(len(new)) / len(new), new
    )
