"""Entities of OpenSCENARIO in motion: along a path at a speed, by a trajectory's times, or as they were recorded.

An entity is stepped through time; `tracks` are where it was, and when it was there.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from ...geometry import FloatArray, Trajectory
from .paths import Curve, Place, between, place_of

STEP_S = 0.02
"""Motions are worked out in steps of at most this length."""
KEY_S = 0.1
"""Keys of a motion at a speed are so far apart."""
JUMP_S, SOONEST_S = 1e-4, 1e-7
"""Time from the key at an entity's former place to its jump, and the least from the key before to that, seconds."""
SAME_M, JUMP_M = 1e-3, 0.05
BESIDE_M = 1.0
ALONG_RAD = math.radians(20)
"""Largest angle from its recorded path, within `BESIDE_M`, at which an entity starts along it; others go straight."""
BACKWARD_RAD = math.radians(110)
"""Angle from its path beyond which an entity drives it the other way; one that looks across it drives along it."""
FADES_M = 10.0
"""A start beside a path's height and heading comes to those of the path within this way."""
STANDS_M_S = 0.01


@dataclass(frozen=True, eq=False)
class EntityTrack:
    """Where an entity's reference point is: ``places`` at ``times_s``, one place stands, none is as recorded. It is there from
    ``appears_s`` until ``vanishes_s``; None: from the start, to the end."""

    times_s: list[float]
    places: list[Place]
    appears_s: float | None
    vanishes_s: float | None


@dataclass(frozen=True, eq=False)
class Spot:
    """A place, and the path that it lies on where it is given by one: arc length, distance to the left, and that of the middle of
    the lane. ``road_sign`` is -1 where the path runs against the road's direction. A place that is given by no path may be given
    ``beside`` an entity."""

    place: Place
    curve: Curve | None = None
    s_m: float = 0.0
    left_m: float = 0.0
    lane_left_m: float = 0.0
    road_sign: int = 1
    beside: Entity | None = None


def driven(
    curve: Curve, s_m: float, left_m: float, lane_m: float, sign: int, turned: tuple[float, float, float]
) -> Spot:
    """Return a place on a path, turned from it. Who is turned round drives the path from its other end."""
    turn, pitch, roll = turned
    if math.cos(turn) < math.cos(BACKWARD_RAD):
        curve, s_m, left_m, lane_m, sign = curve.reversed(), curve.length_m - s_m, -left_m, -lane_m, -sign
        turn -= math.copysign(math.pi, turn)
    x, y, z, h, p, r = curve.at(s_m, left_m)
    return Spot((x, y, z, h + turn, p + pitch, r + roll), curve, s_m, left_m, lane_m, sign)


class TimedPlaces:
    """A trajectory with times: ``places`` (N, 6) at ``times_s`` (N,), N >= 1."""

    def __init__(self, times_s: FloatArray, places: FloatArray) -> None:
        self.times_s, self.places = times_s, places.copy()
        self.places[:, 3:] = np.unwrap(self.places[:, 3:], axis=0)
        self.curve = Curve.through(self.places, False)
        steps = np.linalg.norm(np.diff(self.places[:, :2], axis=0), axis=1)
        self.along = np.concatenate([[0.0], np.cumsum(np.where(steps > 1e-6, steps, 0.0))])

    def at(self, time_s: float) -> Place:
        """Return the place at a time; the first and the last one beyond the ends."""
        return between(self.times_s, self.places, time_s)

    def velocity(self, time_s: float) -> tuple[float, float]:
        """Return the velocity in the plane right after a time; at the end that of the last part."""
        if len(self.times_s) < 2:
            return 0.0, 0.0
        part = min(max(int(np.searchsorted(self.times_s, time_s + 1e-9, side="right")) - 1, 0), len(self.times_s) - 2)
        step = self.places[part + 1, :2] - self.places[part, :2]
        vx, vy = step / (self.times_s[part + 1] - self.times_s[part])
        return float(vx), float(vy)

    def s_at(self, time_s: float) -> float:
        """Return the arc length at a time."""
        return float(np.interp(time_s, self.times_s, self.along))


class Controller(Protocol):
    """Control of an entity's speed, or of its distance to the left of its path, until it is done."""

    def value(self, time_s: float) -> float:
        """Return the speed, or the distance."""

    def done(self, time_s: float) -> bool:
        """Whether it has come to its end."""


@dataclass(eq=False)
class Hangs:
    """The speed of another entity, and a way to it that is kept exactly: ``off`` gives what it is wrong by."""

    other: Entity
    off: Callable[[float], float | None]

    def value(self, time_s: float) -> float:
        return self.other.speed(time_s)

    def done(self, time_s: float) -> bool:
        return False


@dataclass(eq=False)
class Entity:
    """An entity: ``centre`` is the middle of its box from its reference point, ``size_m`` length, width and height. ``recorded``
    is the trajectory of its reference point in the log, if it is there."""

    name: str
    centre: tuple[float, float, float]
    size_m: tuple[float, float, float]
    recorded: Trajectory | None
    span_s: tuple[float, float]
    says_size: bool = False
    is_there: bool = True
    appears_s: float | None = None
    tracks: list[EntityTrack] = field(default_factory=list)
    curve: Curve | None = None
    s_m: float = 0.0
    left_m: float = 0.0
    lane_left_m: float = 0.0
    road_sign: int = 1
    speed_m_s: float = 0.0
    acceleration_m_s2: float = 0.0
    way_m: float = 0.0
    still_s: float = 0.0
    timed: TimedPlaces | None = None
    pending: TimedPlaces | None = None
    longitudinal: Controller | None = None
    lateral: Controller | None = None
    cut_s: float | None = None
    jumps: list[tuple[float, float]] = field(default_factory=list)
    backs: bool = False
    """Whether its speed has become negative on a trajectory without times."""
    _next_speed_m_s: float = 0.0
    _keys: list[tuple[float, Place]] = field(default_factory=list)
    _extra: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    _extra_from_m: float | None = None
    _slip: float = 0.0
    _recorded_curve: Curve | None = None

    def state(self) -> dict[str, Any]:
        """Return all that changes as it moves, for `restore`."""
        return {name: list(value) if isinstance(value, list) else value for name, value in vars(self).items()}

    def restore(self, state: dict[str, Any]) -> None:
        """Have it be as it was when `state` was called."""
        vars(self).update(state)

    @property
    def is_recorded(self) -> bool:
        """Whether it still moves as it was recorded."""
        return self.curve is None and self.timed is None

    def place(self, time_s: float) -> Place | None:
        """Return where it is now; None where nobody knows."""
        if self.timed is not None:
            return self.timed.at(time_s)
        if self.curve is not None:
            x, y, z, h, p, r = self.curve.at(self.s_m, self.left_m)
            since = self._extra_from_m
            fades = 1.0 if since is None else max(0.0, 1 - abs(self.way_m - since) / FADES_M)
            dz, dh, dp, dr = (fades * offset for offset in self._extra)
            return x, y, z + dz, h + dh + self._slip, p + dp, r + dr
        return None if self.recorded is None else place_of(self.recorded.at(time_s))

    def velocity(self, time_s: float) -> tuple[float, float]:
        """Return the velocity in the plane."""
        if self.timed is not None:
            return self.timed.velocity(time_s)
        if self.curve is not None:
            # a box may be turned from where it drives
            (x, y), (to_x, to_y) = (self.curve.at(self.s_m + step)[:2] for step in (-0.01, 0.01))
            heading = math.atan2(to_y - y, to_x - x) + self._slip
            return self.speed_m_s * math.cos(heading), self.speed_m_s * math.sin(heading)
        if self.recorded is None:
            return 0.0, 0.0
        ends = self.recorded.positions_at(np.array([time_s - 0.05, time_s + 0.05]))
        return float(ends[1, 0] - ends[0, 0]) / 0.1, float(ends[1, 1] - ends[0, 1]) / 0.1

    def speed(self, time_s: float) -> float:
        """Return the speed, negative backward."""
        if self.curve is not None and self.timed is None:
            return self.speed_m_s
        vx, vy = self.velocity(time_s)
        place = self.place(time_s)
        ahead = 1.0 if place is None or vx * math.cos(place[3]) + vy * math.sin(place[3]) >= 0 else -1.0
        return ahead * math.hypot(vx, vy)

    def on_path(self, time_s: float) -> tuple[Curve, float, float] | None:
        """Return the path that it is on, its arc length there, and how far left of it it is."""
        place = self.place(time_s)
        if place is None:
            return None
        if self.timed is not None and self.timed.curve is not None:
            return self.timed.curve, self.timed.s_at(time_s), 0.0
        if self.timed is None and self.curve is not None:
            return self.curve, self.s_m, self.left_m
        curve = self.recorded_curve
        if self.timed is None and curve is not None:
            return (curve, *curve.project(place[0], place[1]))
        return Curve.straight(place), 0.0, 0.0

    @property
    def recorded_curve(self) -> Curve | None:
        """The path that was recorded; None where it stood, or was not recorded."""
        if self._recorded_curve is None and self.recorded is not None:
            self._recorded_curve = Curve.recorded(self.recorded, *self.span_s)
        return self._recorded_curve

    @property
    def lane_offset_m(self) -> float:
        """How far it is from its lane's middle, to the left of its road's direction."""
        on_path = self.curve is not None and self.timed is None
        return self.road_sign * (self.left_m - self.lane_left_m) if on_path else 0.0

    def put(self, spot: Spot, time_s: float) -> None:
        """Put it at a place, from which it goes on at its speed."""
        speed, spot = self.carried(time_s), self._on_its_path(spot, time_s)
        self.changed(time_s)
        x, y, z, h, p, r = spot.place
        self.timed = self.pending = None
        self.lateral = None
        self.curve, self.s_m, self.left_m = spot.curve, spot.s_m, spot.left_m
        self.lane_left_m, self.road_sign, self._slip = spot.lane_left_m, spot.road_sign, 0.0
        if self.curve is None:
            near = self.recorded_curve
            if near is not None:
                s, left = near.project(x, y)
                turned = math.remainder(near.at(s)[3] - h, math.tau)
                if abs(left) <= BESIDE_M and abs(turned) <= ALONG_RAD:
                    self.curve, self.s_m, self.left_m, self.lane_left_m = near, s, left, left
        if self.curve is None:
            self.curve, self.s_m, self.left_m, self.lane_left_m = Curve.straight(spot.place), 0.0, 0.0, 0.0
        _, _, there_z, there_h, there_p, there_r = self.curve.at(self.s_m, self.left_m)
        turned = math.remainder(h - there_h, math.tau)
        self._extra = z - there_z, turned, p - there_p, r - there_r
        # what a position in a lane says of its turn holds on the way, too
        self._extra_from_m = None if spot.curve is not None else self.way_m
        self.speed_m_s = speed
        self.arrive(time_s)

    def _on_its_path(self, spot: Spot, time_s: float) -> Spot:
        """Return a place that is given beside itself as one on the path that it is on."""
        path, here = self.on_path(time_s), self.place(time_s)
        if spot.beside is not self or path is None or here is None:
            return spot
        curve, s, left = path
        if math.dist(here[:2], spot.place[:2]) > SAME_M:
            s, left = curve.project(*spot.place[:2])
        lane = self.lane_left_m if curve is self.curve else left
        turn = math.remainder(spot.place[3] - curve.at(s)[3], math.tau)
        return replace(driven(curve, s, left, lane, self.road_sign, (turn, 0.0, 0.0)), place=spot.place)

    def carried(self, time_s: float) -> float:
        """Return the speed that a new motion starts with: 0 at the start, where nothing was said before."""
        starts = self.is_recorded and (time_s <= self.span_s[0] or not self.is_there)
        return self.speed_m_s if starts or self.place(time_s) is None else self.speed(time_s)

    def drive(self, time_s: float) -> None:
        """Have it leave its recording or its trajectory's times, and go on along the same path at its speed."""
        if self.curve is not None and self.timed is None:
            self.changed(time_s)
            return
        path, speed = self.on_path(time_s), self.carried(time_s)
        if path is None:
            return
        place = self.place(time_s)
        assert place is not None  # it is on a path
        self.changed(time_s)
        curve, s, left = path
        self.timed = None
        self.curve, self.s_m, self.left_m, self.lane_left_m, self.speed_m_s = curve, s, left, left, speed
        self._slip, there = 0.0, curve.at(s, left)
        self._extra = (place[2] - there[2], math.remainder(place[3] - there[3], math.tau), 0.0, 0.0)
        self._extra_from_m = self.way_m
        self.arrive(time_s)

    def follow(self, curve: Curve, s_m: float, time_s: float) -> None:
        """Have it drive along a path from an arc length on. Where its speed is negative, its rear is ahead."""
        speed = self.carried(time_s)
        self.changed(time_s)
        self.timed = self.pending = self.lateral = None
        self.curve, self.s_m, self.left_m, self.lane_left_m, self._slip = curve, s_m, 0.0, 0.0, 0.0
        self._extra, self.speed_m_s = (0.0, 0.0, 0.0, 0.0), speed
        self.arrive(time_s)

    def keep_times(self, timed: TimedPlaces, time_s: float) -> None:
        """Have it be where a trajectory is at each time."""
        self.changed(time_s)
        self.timed, self.pending, self.longitudinal, self.lateral = timed, None, None, None
        self.arrive(time_s)

    def appear(self, time_s: float, at_start: bool) -> None:
        """Have it be there from now on."""
        self.is_there, self.appears_s = True, None if at_start else time_s

    def vanish(self, time_s: float) -> None:
        """Have it be there no longer."""
        self.changed(time_s)
        self._close(time_s)
        self.is_there, self.timed, self.pending, self.longitudinal, self.lateral = False, None, None, None, None
        self.speed_m_s = 0.0

    def finish(self, time_s: float) -> None:
        """Note its motion until the end of the drive."""
        if self.is_there:
            untouched = self.is_recorded and not self._keys
            if not untouched:
                self.changed(time_s)
            if self.timed is not None and float(self.timed.times_s[-1]) > time_s + 1e-6:
                self.cut_s = float(self.timed.times_s[-1])
            self._close(None)

    def plan(self, time_s: float) -> None:
        """Choose the speed at a time from where all entities are, before any of them goes on."""
        controller = self.longitudinal if self.curve is not None and self.timed is None else None
        self._next_speed_m_s = self.speed_m_s if controller is None else controller.value(time_s)

    def advance(self, before_s: float, time_s: float, watched: bool) -> None:
        """Go on from one time to another. ``watched``: conditions ask for its speed, its acceleration and its way."""
        former, was, length = None, 0.0, time_s - before_s
        if watched:
            former, was = self.place(before_s), self.speed(before_s)
        if self.timed is not None and time_s > float(self.timed.times_s[-1]) + 1e-9:
            # behind its last time it goes on as it came there
            before_s = max(before_s, float(self.timed.times_s[-1]))
            self._past_the_end(float(self.timed.times_s[-1]))
        if self.curve is not None and self.timed is None:
            self._move(before_s, time_s)
        if self.pending is not None and time_s >= float(self.pending.times_s[0]) - 1e-9:
            self.keep_times(self.pending, time_s)
        if watched:
            goes = self.curve is not None and self.timed is None
            now, place = self.speed(time_s), self.place(time_s)
            self.acceleration_m_s2 = (now - was) / length
            self.still_s = self.still_s + length if abs(now) < STANDS_M_S else 0.0
            if former is not None and place is not None and not goes:
                self.way_m += math.hypot(place[0] - former[0], place[1] - former[1])

    def settle(self, time_s: float) -> None:
        """Hang on to another entity after that has gone on, and note a key where one is due."""
        if self.curve is None or self.timed is not None:
            return
        if isinstance(self.longitudinal, Hangs):
            self.s_m += self.longitudinal.off(time_s) or 0.0
        elif self.longitudinal is not None and self.longitudinal.done(time_s):
            self.longitudinal = None
        if not self._keys or time_s - self._keys[-1][0] >= KEY_S - 1e-6:
            self._note(time_s)

    def _move(self, before_s: float, time_s: float) -> None:
        assert self.curve is not None
        was = self.speed_m_s
        if self.longitudinal is not None:
            self.speed_m_s = self._next_speed_m_s
        way = (was + self.speed_m_s) / 2 * (time_s - before_s)
        bend = min(max(1 - self.curve.curvature(self.s_m) * self.left_m, 0.2), 5.0)
        if not isinstance(self.longitudinal, Hangs):
            self.s_m += way / bend
        self.way_m += abs(way)
        self._slip = 0.0
        if self.lateral is not None:
            left = self.lateral.value(time_s)
            if way and abs(left - self.left_m) < abs(way):
                self._slip = math.atan2(left - self.left_m, way) if way > 0 else math.atan2(self.left_m - left, -way)
            self.left_m = left
            if self.lateral.done(time_s):
                self.lateral = None

    def _past_the_end(self, end_s: float) -> None:
        assert self.timed is not None
        timed = self.timed
        speed, curve = self.speed(end_s), timed.curve or Curve.straight(timed.at(end_s))
        self.changed(end_s)
        self.timed, self.curve, self.s_m, self.left_m, self.lane_left_m = None, curve, timed.s_at(end_s), 0.0, 0.0
        self._extra, self._slip, self.speed_m_s = (0.0, 0.0, 0.0, 0.0), 0.0, speed

    def changed(self, time_s: float) -> None:
        """Note its motion until now, before another one begins."""
        if not self.is_there:
            return
        begins = self._keys[-1][0] if self._keys else self.span_s[0] if self.appears_s is None else self.appears_s
        own = np.zeros(0)
        if self.timed is not None:
            own = self.timed.times_s
        elif self.curve is None and self.recorded is not None:
            own = self.recorded.times_s
            if not self._keys:
                own = np.concatenate([[begins], own])
        for time in own[(own >= begins) & (own < time_s - 1e-9)].tolist():
            self._note(time)
        self._note(time_s)

    def _note(self, time_s: float) -> None:
        place = self.place(time_s)
        if place is not None and (not self._keys or time_s > self._keys[-1][0] + 1e-9):
            self._keys.append((time_s, place))

    def arrive(self, time_s: float) -> None:
        """Begin a motion: what is elsewhere now was at its former place until a moment ago."""
        place = self.place(time_s)
        if not self.is_there or place is None or time_s >= self.span_s[1] - 1e-9 > self.span_s[0]:
            return
        if self._keys and abs(self._keys[-1][0] - time_s) < 1e-9:
            _, former = self._keys.pop()
            away = math.dist(former[:3], place[:3])
            if (
                away > SAME_M
                or max(abs(math.remainder(a - b, math.tau)) for a, b in zip(former, place, strict=True)) > 1e-3
            ):
                began = self.span_s[0] if self.appears_s is None else self.appears_s
                last = self._keys[-1][0] if self._keys else began
                if time_s > began + 1e-9 and time_s - last > 2 * SOONEST_S:
                    self._keys.append((max(time_s - JUMP_S, last + SOONEST_S), former))
                    if away > JUMP_M:
                        self.jumps.append((time_s, away))
        self._keys.append((time_s, place))

    def _close(self, vanishes_s: float | None) -> None:
        keys = _thinned(self._keys)
        self.tracks.append(
            EntityTrack([time for time, _ in keys], [place for _, place in keys], self.appears_s, vanishes_s)
        )
        self._keys = []


def _thinned(keys: list[tuple[float, Place]]) -> list[tuple[float, Place]]:
    """Return keys without those between two others at the same place; one where all are the same."""
    if all(place == keys[0][1] for _, place in keys):
        return keys[:1]
    inner = [
        here
        for before, here, after in zip(keys, keys[1:], keys[2:], strict=False)
        if not before[1] == here[1] == after[1]
    ]
    return [keys[0], *inner, keys[-1]]
