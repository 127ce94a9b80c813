"""The paths that entities of OpenSCENARIO drive along: recorded ones, straight ones, and the shapes of trajectories.

Points are reference points as `reference` has them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ...geometry import FloatArray, Trajectory, angles_from_rotation, matrix_from_quaternion, rotation_from_angles
from ...world.actor_path import ActorPath
from ...world.drive import EGO, Actor
from ...world.polyline import Polyline

Place = tuple[float, float, float, float, float, float]
"""x, y, z in metres and heading, pitch, roll in radians."""
EGO_NAMES = (EGO, "Ego", "EGO", "hero", "Hero")
"""Names of the entity that stands for the recording vehicle."""
REAR_OVERHANG = 0.2
"""Of a vehicle's length: how far its rear axle is from its rear bumper. No log says it."""


class EgoVehicle(Protocol):
    """The ego vehicle, as the caller states it: sizes in metres; ``ego_from_axle`` (4, 4) is the pose of its rear axle's middle
    in the log's ego frame. `simulation.vehicle.parameters.Vehicle` is one."""

    @property
    def length_m(self) -> float: ...
    @property
    def width_m(self) -> float: ...
    @property
    def wheelbase_m(self) -> float: ...
    @property
    def rear_overhang_m(self) -> float: ...
    @property
    def ego_from_axle(self) -> FloatArray: ...


def box_centre(actor: Actor, is_vehicle: bool) -> tuple[float, float, float]:
    """Return the middle of an actor's box as its reference point sees it."""
    length, _, height = actor.size_m.tolist()
    return (length * (0.5 - REAR_OVERHANG) if is_vehicle else 0.0), 0.0, height / 2


def ego_centre(vehicle: EgoVehicle, height_m: float) -> tuple[float, float, float]:
    """Return the middle of the ego vehicle's box as its reference point sees it."""
    return vehicle.length_m / 2 - vehicle.rear_overhang_m, 0.0, height_m / 2


def shifted(offset: tuple[float, float, float]) -> FloatArray:
    """Return the pose (4, 4) of a point at an offset."""
    pose = np.eye(4)
    pose[:3, 3] = offset
    return pose


def place_of(pose: FloatArray) -> Place:
    """Return x, y, z and heading, pitch, roll of a pose (4, 4), in the order of `WorldPosition`'s attributes x to r."""
    yaw, pitch, roll = (float(angle) for angle in angles_from_rotation(pose[:3, :3]))
    x, y, z = pose[:3, 3].tolist()
    return x, y, z, yaw, pitch, roll


def pose_at(place: Place) -> FloatArray:
    """Return the pose (4, 4) of `place_of`."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_from_angles(*(np.asarray(angle, np.float64) for angle in place[3:]))
    pose[:3, 3] = place[:3]
    return pose


LANE_WIDTH_M = 3.5
"""Of a lane, where no road network says it."""
TURN_M, TURN_S = 1.5, 0.25
"""A heading that follows a polyline turns within this distance, or time, before and after a corner."""
CURVE_STEP_M = 0.25
"""Arcs, clothoids and splines become lines of this length."""
MOST_POINTS, MOST_VALUES = 100_000, 5_000_000


@dataclass(eq=False)
class Curve:
    """A path by arc length in the plane: ``s_m`` (N,) increasing from 0, N >= 2, and ``places`` (N, 6), headings without steps
    of a turn. It goes straight on beyond both ends: where it came from, or along its headings where it is ``headed``.
    ``backward``: it is another path the other way."""

    s_m: FloatArray
    places: FloatArray
    headed: bool = False
    backward: bool = False
    _back: Curve | None = field(default=None, init=False, repr=False)

    def __post_init__(self) -> None:
        ends = []
        for here, after in ((0, 1), (-2, -1)):
            step = self.places[after, :2] - self.places[here, :2]
            unit = step / np.linalg.norm(step)
            if self.headed:
                heading = float(self.places[0 if here == 0 else -1, 3])
                ahead = np.array([math.cos(heading), math.sin(heading)])
                unit = ahead if ahead @ unit >= 0 else -ahead
            ends.append(unit)
        self._ends = ends
        self._line = Polyline(self.places[:, :2], self.s_m, before=ends[0], after=ends[1])

    @staticmethod
    def straight(place: Place) -> Curve:
        """Return the level path straight on from a place, along its heading."""
        ahead = np.array(place)
        ahead[:2] += 10.0 * np.array([math.cos(place[3]), math.sin(place[3])])
        return Curve(np.array([0.0, 10.0]), np.stack([np.array(place), ahead]))

    @staticmethod
    def recorded(trajectory: Trajectory, start_s: float, end_s: float) -> Curve | None:
        """Return the path of a recorded trajectory between two times; None where it stands."""
        path = ActorPath.recorded(trajectory, start_s, max(start_s, end_s), False)
        if path is None:
            return None
        angles = np.stack(angles_from_rotation(matrix_from_quaternion(path.quaternions_wxyz)), 1)
        angles[:, 0] = np.unwrap(angles[:, 0])
        return Curve(path.s_m, np.concatenate([path.positions, angles], 1), headed=True)

    @staticmethod
    def through(places: FloatArray, follows: bool) -> Curve | None:
        """Return the path through places (N, 6), headed along itself where it ``follows``, else as the places are; None where
        they are all one."""
        lengths = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
        is_apart = np.concatenate([[True], lengths > 1e-6])
        places, lengths = places[is_apart].copy(), lengths[lengths > 1e-6]
        if len(places) < 2:
            return None
        s = np.concatenate([[0.0], np.cumsum(lengths)])
        if follows:
            s, places = along_itself(s, places, TURN_M)
        else:
            places[:, 3] = np.unwrap(places[:, 3])
        return Curve(s, places)

    @property
    def length_m(self) -> float:
        return float(self.s_m[-1])

    def at(self, s_m: float, left_m: float = 0.0) -> Place:
        """Return the place at an arc length, so far to the left of the path."""
        inside = min(max(s_m, 0.0), self.length_m)
        x, y, z, h, p, r = between(self.s_m, self.places, inside)
        beyond = s_m - inside
        if beyond:
            end = self._ends[0 if beyond < 0 else 1]
            x, y = x + beyond * float(end[0]), y + beyond * float(end[1])
        return x - left_m * math.sin(h), y + left_m * math.cos(h), z, h, p, r

    def curvature(self, s_m: float) -> float:
        """Return the heading's change by arc length, 1/m, left positive; 0 beyond the ends."""
        if not 0 <= s_m <= self.length_m:
            return 0.0
        part = min(max(int(np.searchsorted(self.s_m, s_m, side="right")) - 1, 0), len(self.s_m) - 2)
        return float((self.places[part + 1, 3] - self.places[part, 3]) / (self.s_m[part + 1] - self.s_m[part]))

    def project(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return the arc length of the nearest place of the path, and how far left of it a point lies."""
        projected = self._line.project(x_m, y_m)
        return float(projected.along_m), float(projected.left_m)

    def reversed(self) -> Curve:
        """Return the same path the other way; the reverse of that is this one."""
        if self._back is None:
            places = self.places[::-1].copy()
            places[:, 3] += math.pi
            places[:, 4:] *= -1
            self._back = Curve(self.length_m - self.s_m[::-1], places, self.headed, not self.backward)
            self._back._back = self
        return self._back


def arc_lengths(places: FloatArray) -> FloatArray:
    """Return the arc length in the plane (N,), from 0, of each of places (N, 2+)."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1))])


def between(keys: FloatArray, places: FloatArray, value: float) -> Place:
    """Return the place at a value of increasing keys (N,) of places (N, 6), N >= 1; those of the ends beyond them."""
    if len(keys) == 1:
        x, y, z, h, p, r = places[0].tolist()
        return x, y, z, h, p, r
    part = min(max(int(np.searchsorted(keys, value, side="right")) - 1, 0), len(keys) - 2)
    share = (value - float(keys[part])) / float(keys[part + 1] - keys[part])
    share = min(max(share, 0.0), 1.0)
    x, y, z, h, p, r = ((1 - share) * places[part] + share * places[part + 1]).tolist()
    return x, y, z, h, p, r


def along_itself(parameter: FloatArray, places: FloatArray, reach: float) -> tuple[FloatArray, FloatArray]:
    """Return a polyline's parameter (M,), a length or a time, and places (M, 6) with the headings of its parts, which turn within
    ``reach`` of its corners. Where it does not move the heading stays."""
    steps = np.diff(places[:, :2], axis=0)
    moves = np.linalg.norm(steps, axis=1) > 1e-6
    if not moves.any():
        return parameter, places
    headings = np.arctan2(steps[:, 1], steps[:, 0])
    # a part that stands is headed as the one before it, the first ones as the first that moves
    source = np.maximum.accumulate(np.where(moves, np.arange(len(steps)), -1))
    source[source < 0] = int(np.argmax(moves))
    headings = np.unwrap(headings[source])
    times, values = [float(parameter[0])], [float(headings[0])]
    for corner in range(1, len(places) - 1):
        now, before, after = (float(parameter[corner + step]) for step in (0, -1, 1))
        back, ahead = min(reach, (now - before) / 2), min(reach, (after - now) / 2)
        middle = headings[corner - 1] + (headings[corner] - headings[corner - 1]) * back / (back + ahead)
        for time, value in ((now - back, headings[corner - 1]), (now, middle), (now + ahead, headings[corner])):
            if time > times[-1] + 1e-9:
                times.append(time)
                values.append(float(value))
    times.append(float(parameter[-1]))
    values.append(float(headings[-1]))
    every = np.array(times)
    columns = [np.interp(every, parameter, column) for column in places.T]
    columns[3] = np.array(values)
    return every, np.stack(columns, 1)


def clothoid(start: Place, first: float, last: float, length_m: float) -> FloatArray:
    """Return places (N, 6) of a clothoid from a place on, between two curvatures, 1/m."""
    x, y, z, h, p, r = start
    count = min(max(math.ceil(length_m / CURVE_STEP_M), 1), MOST_POINTS)
    s = np.linspace(0.0, length_m, count + 1)
    rate = (last - first) / length_m if length_m else 0.0
    headings = h + first * s + rate * s * s / 2
    # the heading in the middle of each step
    middles = (s[:-1] + s[1:]) / 2
    ahead = h + first * middles + rate * middles * middles / 2
    steps = np.diff(s)[:, None] * np.stack([np.cos(ahead), np.sin(ahead)], 1)
    places = np.tile(np.array([x, y, z, h, p, r]), (count + 1, 1))
    places[1:, :2] += np.cumsum(steps, 0)
    places[:, 3] = headings
    return places


def nurbs(order: int, points: FloatArray, weights: FloatArray, knots: FloatArray) -> FloatArray:
    """Return places (N, C) of a rational spline by its control points (K, C), x and y first."""
    count = len(points)
    low, high = knots[order - 1], knots[count]
    length = float(np.linalg.norm(np.diff(points[:, :2], axis=0), axis=1).sum())
    steps = min(max(int(length / CURVE_STEP_M), 10 * count), MOST_POINTS, max(MOST_VALUES // count, 2))
    u = np.linspace(low, high, steps)
    inside = np.minimum(u, np.nextafter(high, low))
    basis = [((knots[i] <= inside) & (inside < knots[i + 1])).astype(float) for i in range(len(knots) - 1)]
    for degree in range(1, order):
        risen = []
        for i in range(len(basis) - 1):
            left, right = knots[i + degree] - knots[i], knots[i + degree + 1] - knots[i + 1]
            value = np.zeros_like(u)
            if left > 0:
                value = value + (inside - knots[i]) / left * basis[i]
            if right > 0:
                value = value + (knots[i + degree + 1] - inside) / right * basis[i + 1]
            risen.append(value)
        basis = risen
    parts = np.stack(basis[:count], 1) * weights
    return np.asarray(parts @ points / parts.sum(1, keepdims=True))


@dataclass(eq=False)
class Lanes:
    """The lanes of one road, beside a recorded path that stands for it: ``lane_left_m`` is how far left of the road's reference
    line the path runs, ``s_m`` the road's length coordinate at the path's start, ``sign`` -1 where the path runs against it, and
    ``heading`` that of the path at its start in the file's world."""

    curve: Curve
    road: str
    s_m: float
    lane_left_m: float
    sign: int
    heading: float

    def on(self, s_m: float, left_m: float) -> tuple[float, float]:
        """Return arc length and distance to the left of `curve` at the road's coordinates."""
        return self.sign * (s_m - self.s_m), self.sign * (left_m - self.lane_left_m)

    def road_left(self, left_m: float) -> float:
        """Return how far left of the road's reference line lies what is so far left of `curve`."""
        return self.lane_left_m + self.sign * left_m


@dataclass(frozen=True)
class OnRoad:
    """A position on a road in Init: its entity, how far along and left of the road's line it is, 1 where it is headed along the
    road, else -1, and its heading in the file's world where that is given."""

    entity: str
    road: str
    s_m: float
    left_m: float
    side: int
    heading: float | None


def lane_left(lane: int) -> float:
    """Return how far left of a road's reference line the middle of a lane lies, in metres."""
    return math.copysign((abs(lane) - 0.5) * LANE_WIDTH_M, lane) if lane else 0.0
