"""Motions of OpenSCENARIO's actions in time: what runs after an action has started, and controllers of speed and of the distance
to the left of a path."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from .document import NotUnderstoodError
from .entities import Controller, Entity, TimedPlaces
from .paths import Curve

FASTEST_M_S = 80.0
GAP_PER_S = 0.5
"""Share of a distance's error that a controller makes up in a second."""


class Running(Protocol):
    """An action that has started."""

    def done(self, time_s: float) -> bool:
        """Whether it has ended."""

    def stop(self, time_s: float) -> None:
        """End it."""


class Done:
    """An action that ends as it starts."""

    def done(self, time_s: float) -> bool:
        return True

    def stop(self, time_s: float) -> None:
        """Do nothing."""


@dataclass
class Controls:
    """An action that runs while its controller has the entity's speed ("longitudinal") or its place across its path
    ("lateral")."""

    entity: Entity
    controller: Controller
    axis: str

    def done(self, time_s: float) -> bool:
        """Whether the controller is at its end, or another one has taken its place."""
        return getattr(self.entity, self.axis) is not self.controller

    def stop(self, time_s: float) -> None:
        if not self.done(time_s):
            self.entity.changed(time_s)
            setattr(self.entity, self.axis, None)


def control(entity: Entity, controller: Controller, axis: str, time_s: float) -> Running:
    """Give an entity a controller of an axis, "longitudinal" or "lateral"; none where it is done as it starts."""
    is_done = controller.done(time_s)
    setattr(entity, axis, None if is_done else controller)
    return Done() if is_done else Controls(entity, controller, axis)


@dataclass
class Follows:
    """An action that runs while its entity is on a path, or waits for a trajectory's first time."""

    entity: Entity
    path: TimedPlaces | Curve
    in_reverse: bool = False

    def done(self, time_s: float) -> bool:
        """Whether the entity has come to the end, or has left the path."""
        entity = self.entity
        if isinstance(self.path, Curve):
            if entity.curve is not self.path or entity.timed is not None:
                return True
            # what backs along it is at its end at an arc length of 0
            left, speed = self.path.length_m - entity.s_m, entity.speed(time_s)
            if self.in_reverse:
                left, speed = entity.s_m, -speed
            entity.backs = entity.backs or speed < 0
            return left <= 1e-6 or (speed < 0 and left >= self.path.length_m - 1e-6)
        if entity.pending is self.path:
            return False
        return entity.timed is not self.path or time_s >= float(self.path.times_s[-1]) - 1e-9

    def stop(self, time_s: float) -> None:
        """Have the entity go on along its path, without times."""
        if self.entity.pending is self.path:
            self.entity.pending = None
        if self.entity.timed is self.path:
            self.entity.drive(time_s)


def eased(shape: str, share: float) -> float:
    """Return which part of a change is made after a part of its time."""
    share = min(max(share, 0.0), 1.0)
    if shape == "sinusoidal":
        return (1 - math.cos(math.pi * share)) / 2
    return share * share * (3 - 2 * share) if shape == "cubic" else share


STEEPEST = {"linear": 1.0, "sinusoidal": math.pi / 2, "cubic": 1.5, "step": 1.0}
"""The largest slope of a change over its time, by shape: a rate is reached where it is steepest."""


@dataclass(eq=False)
class Change:
    """A speed, or a place across the path, that comes to ``target`` within ``takes_s``, or while ``way`` grows by ``way_m``. One
    that is ``continuous`` has no end."""

    shape: str
    begins_s: float
    start: float
    target: Callable[[], float]
    takes_s: float
    continuous: bool = False
    way: Callable[[], float] | None = None
    way_m: float = 0.0
    _from_m: float = field(init=False)

    def __post_init__(self) -> None:
        self._from_m = self.way() if self.way is not None else 0.0

    def _share(self, time_s: float) -> float:
        if self.way is not None:
            return (self.way() - self._from_m) / self.way_m if self.way_m > 0 else 1.0
        return (time_s - self.begins_s) / self.takes_s if self.takes_s > 0 else 1.0

    def value(self, time_s: float) -> float:
        return self.start + (self.target() - self.start) * eased(self.shape, self._share(time_s))

    def done(self, time_s: float) -> bool:
        return not self.continuous and self._share(time_s) >= 1 - 1e-9


@dataclass(eq=False)
class Dynamics:
    """How a change is made: its shape, and its time, its rate or its distance."""

    shape: str
    dimension: str
    value: float

    def change(self, entity: Entity, time_s: float, start: float, target: Callable[[], float], across: bool) -> Change:
        """Return the change from a value to another one. Raises `NotUnderstoodError` for a rate of 0."""
        away, amount = abs(target() - start), abs(self.value)
        if self.shape == "step" or away == 0:
            return Change("step", time_s, start, target, 0.0)
        if self.dimension == "time":
            return Change(self.shape, time_s, start, target, amount)
        if self.dimension == "rate":
            if amount == 0:
                raise NotUnderstoodError("a rate of 0")
            return Change(self.shape, time_s, start, target, STEEPEST[self.shape] * away / amount)
        if across:
            return Change(self.shape, time_s, start, target, 0.0, way=lambda: entity.way_m, way_m=amount)
        # every shape's mean speed is half way between both
        mean = abs(start + target()) / 2
        if mean == 0:
            raise NotUnderstoodError("a distance without a speed")
        return Change(self.shape, time_s, start, target, amount / mean)


@dataclass(eq=False)
class Profile:
    """Speeds at times, linear between them."""

    times_s: list[float]
    speeds: list[float]

    def value(self, time_s: float) -> float:
        return float(np.interp(time_s, self.times_s, self.speeds))

    def done(self, time_s: float) -> bool:
        return time_s >= self.times_s[-1] - 1e-9


@dataclass(eq=False)
class KeepsGap:
    """A speed that makes the way to another entity so long, and keeps it so where it is ``continuous``."""

    entity: Entity
    other: Entity
    off: Callable[[float], float | None]
    limits: tuple[float, float, float]
    continuous: bool
    last_s: float

    def value(self, time_s: float) -> float:
        accelerates, brakes, fastest = self.limits
        before_s, self.last_s = self.last_s, time_s
        off, now, step = self.off(before_s), self.entity.speed_m_s, time_s - before_s
        if off is None:
            return now
        wanted = min(self.other.speed(before_s) + GAP_PER_S * off, fastest)
        return max(min(wanted, now + accelerates * step), now - brakes * step, 0.0)

    def done(self, time_s: float) -> bool:
        off = self.off(time_s)
        return not self.continuous and (off is None or abs(off) < 0.05)


@dataclass(eq=False)
class KeepsBeside:
    """A place across the path that is so far beside another entity, reached at a speed across of at most ``fastest`` that changes
    by at most ``hardest``, m/s²."""

    entity: Entity
    goal: Callable[[float], float | None]
    fastest: float
    hardest: float
    continuous: bool
    last_s: float
    across_m_s: float = 0.0

    def value(self, time_s: float) -> float:
        goal, now, step = self.goal(time_s), self.entity.left_m, time_s - self.last_s
        self.last_s = time_s
        if goal is None or step <= 0:
            return now
        # so fast that it can stop there
        most = min(self.fastest, math.sqrt(2 * self.hardest * abs(goal - now)))
        wanted = min(max((goal - now) / step, -most), most)
        change = self.hardest * step
        self.across_m_s = min(max(wanted, self.across_m_s - change), self.across_m_s + change)
        return now + self.across_m_s * step

    def done(self, time_s: float) -> bool:
        goal = self.goal(time_s)
        return not self.continuous and (goal is None or abs(goal - self.entity.left_m) < 1e-3)


@dataclass(eq=False)
class Arrives:
    """A speed by which an entity comes to a place when another one comes to its own. It changes linearly from the one that it
    has, with a final speed, which is held for ``steady_m`` or ``steady_s`` at the end, as a parabola."""

    entity: Entity
    way_left: Callable[[float], float | None]
    others_time_s: Callable[[float], float | None]
    final: Callable[[], float] | None
    steady_m: float
    steady_s: float
    last_s: float
    over: bool = False

    def value(self, time_s: float) -> float:
        before_s, self.last_s = self.last_s, time_s
        way, takes = self.way_left(before_s), self.others_time_s(before_s)
        now, step = self.entity.speed_m_s, time_s - before_s
        final = None if self.final is None else max(self.final(), 0.0)
        if way is None or way <= 0.05 or (takes is not None and takes <= 0.02):
            self.over = True
            return now if final is None else final
        if takes is None:
            return now
        if final is None:
            return min(max(now + 2 * (way / takes - now) * min(step / takes, 0.5), 0.0), FASTEST_M_S)
        steady_m = max(self.steady_m, self.steady_s * final)
        way, takes = way - steady_m, takes - (steady_m / final if final else 0.0)
        if way <= 0 or takes <= 0.02:
            # the last part is at the final speed, unless that comes too late or too early
            return min((way + steady_m) / max(self.others_time_s(before_s) or 0.02, 0.02), FASTEST_M_S)
        return min(max(now + (6 * way / takes - 4 * now - 2 * final) * min(step / takes, 0.25), 0.0), FASTEST_M_S)

    def done(self, time_s: float) -> bool:
        return self.over
