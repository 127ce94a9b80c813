"""Recorded drive as models of actors know it: where everything was, and the paths it took."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from weakref import WeakKeyDictionary

import numpy as np

from ...geometry import FloatArray, Quaternion, Trajectory, Vector3, slerp
from ...world.actor_path import SPEED_WINDOW_S, ActorPath, joined, yaw_of
from ...world.captures import US_PER_SECOND
from ...world.drive import EGO, FRAME_MARGIN_S, Actor, Drive
from ..footprints import times_to_overlap
from ..states import ActorState, Footprint, Traffic
from .lead import Way, separations, swept

CACHED_TIMES = 4
"""A step asks for the poses at its end again and again, and for those that close an exposure."""


class RecordedPoses:
    """Poses of trajectories by their names: each has the bits of its `Trajectory.placed_at`."""

    def __init__(self, trajectories: Mapping[str, Trajectory]) -> None:
        moving = {uid: trajectory for uid, trajectory in trajectories.items() if len(trajectory.times_s) > 1}
        self._times = {uid: trajectory.times_s.tolist() for uid, trajectory in moving.items()}
        self._first = np.cumsum([0, *(len(times) for times in self._times.values())])[:-1]
        self._keys = [
            np.concatenate([getattr(trajectory, name) for trajectory in moving.values()])
            for name in ("times_s", "positions", "quaternions_wxyz")
            if moving
        ]
        self._standing = {
            uid: _pose(trajectory.positions[0].tolist(), trajectory.quaternions_wxyz[0].tolist())
            for uid, trajectory in trajectories.items()
            if uid not in moving
        }
        self._known: dict[float, dict[str, tuple[Vector3, Quaternion]]] = {}

    def at(self, time_s: float) -> Mapping[str, tuple[Vector3, Quaternion]]:
        """Return positions and quaternions at a time, by name."""
        if time_s not in self._known:
            while len(self._known) >= CACHED_TIMES:
                del self._known[next(iter(self._known))]
            self._known[time_s] = self._standing | self._moving(time_s)
        return self._known[time_s]

    def _moving(self, time_s: float) -> dict[str, tuple[Vector3, Quaternion]]:
        if not self._times:
            return {}
        times, positions, quaternions = self._keys
        lower = self._first + [min(max(bisect_right(own, time_s) - 1, 0), len(own) - 2) for own in self._times.values()]
        u = (time_s - times[lower]) / (times[lower + 1] - times[lower])
        placed = positions[lower] + u[:, None] * (positions[lower + 1] - positions[lower])
        turned = slerp(quaternions[lower], quaternions[lower + 1], u)
        poses = map(_pose, placed.tolist(), turned.tolist())
        return dict(zip(self._times, poses, strict=True))


def _pose(position: list[float], quaternion: list[float]) -> tuple[Vector3, Quaternion]:
    (x, y, z), (w, i, j, k) = position, quaternion
    return (x, y, z), (w, i, j, k)


STRAYED_M = 0.25
"""A box that is further from where the recording has it is not where it was recorded."""
LANE_ASIDE_M, LANE_TURN_RAD = 2.5, math.radians(30.0)
"""A recorded path goes on where another ends if it passes within this distance, in a direction within this angle."""
LANE_LEAST_M = 10.0
"""It must go on for this long."""
LANE_MOST_M = 1000.0
"""No lane is continued beyond this length."""


@dataclass(frozen=True, eq=False)
class Strays:
    """Deviations from the recording: how far the ego vehicle is from its recorded place, and the identifiers of all
    boxes of the ``traffic`` further off than `STRAYED_M`."""

    ego_m: float
    uids: tuple[str, ...]
    traffic: Traffic
    _met: dict[float, dict[str, list[tuple[str, float]]]] = field(default_factory=dict, repr=False)

    def overlaps(self, own: Footprint, horizon_s: float) -> list[tuple[str, float]]:
        """Return when a box of the traffic meets those that have strayed, within ``horizon_s``: their identifiers and seconds
        from now."""
        if horizon_s not in self._met:
            which = self.traffic.boxes.chosen([self.traffic.places_of(uid)[0] for uid in self.uids])
            first_s = times_to_overlap(self.traffic.boxes, which, horizon_s)
            rows, columns = np.nonzero(first_s <= horizon_s)
            met: dict[str, list[tuple[str, float]]] = {}
            for row, column, time_s in zip(
                rows.tolist(), columns.tolist(), first_s[rows, columns].tolist(), strict=True
            ):
                met.setdefault(self.traffic.footprints[row].uid, []).append((self.uids[column], time_s))
            self._met[horizon_s] = met
        return self._met[horizon_s].get(own.uid, [])


@dataclass(frozen=True, eq=False)
class Recording:
    """The recorded drive, for models of actors.

    ``actors`` by identifier, ``windows_s``: when each is present. ``world_from_ego_box``: the middle of the ego vehicle's box.
    ``start_s`` and ``end_s``: first and last time of the drive. ``people``: identifiers of the actors that change their shape as
    they move. ``seed`` is the simulation's, from which each actor's random numbers follow.
    """

    actors: Mapping[str, Actor]
    windows_s: Mapping[str, tuple[float, float]]
    world_from_ego_box: Trajectory
    start_s: float
    end_s: float
    people: frozenset[str] = frozenset()
    seed: int = 0
    _last: list[tuple[Traffic, Strays]] = field(default_factory=list, repr=False)
    _continued: dict[str, ActorPath | None] = field(default_factory=dict, repr=False)
    _passed: WeakKeyDictionary[ActorPath, dict[str, frozenset[str]]] = field(
        default_factory=WeakKeyDictionary, repr=False
    )

    @staticmethod
    def of(
        drive: Drive, motion_of: Callable[[str], str | None], seed: int = 0, ego_box_ahead_m: float = 0.0
    ) -> Recording:
        """Return what models may know of a drive.

        ``motion_of`` tells how a class moves (`world.classes.motion_of`); ``ego_box_ahead_m``: how far the middle of the ego
        vehicle's box lies ahead of the origin of its pose.
        """
        mount = np.eye(4)
        mount[0, 3] = ego_box_ahead_m
        actors = {uid: actor for uid, actor in drive.actors.items() if not actor.is_ego_body}
        return Recording(
            actors,
            {uid: drive.window(actor) for uid, actor in actors.items()},
            drive.world_from_ego.transformed(right=mount),
            drive.time_s[drive.frames[0]],
            drive.time_s[drive.frames[-1]],
            frozenset(uid for uid, actor in actors.items() if motion_of(actor.label) == "deforming"),
            seed,
        )

    @cached_property
    def standing(self) -> Traffic:
        """The boxes of all actors that stand as long as they are recorded."""
        boxes = []
        for uid, actor in self.actors.items():
            if self.paths[uid] is None:
                (x, y, _), quaternion = actor.world_from_actor.placed_at(self.windows_s[uid][0])
                length, width, _ = actor.size_m.tolist()
                boxes.append(Footprint(uid, actor.label, x, y, float(yaw_of(quaternion)), length, width, 0.0))
        return Traffic(0, tuple(boxes))

    def prepare(self, uids: Iterable[str]) -> None:
        """Work out what actors with paths ask for when they begin to follow these: many of them may do so in one step."""
        for uid in uids:
            path = self.paths[uid]
            if path is not None and uid not in self.people:
                path.prepare()
                self.passed(self.actors[uid], path)

    def passed(self, actor: Actor, path: ActorPath) -> frozenset[str]:
        """Return what stands in the recording so near that an actor on this path would go through it. Labels of the two overlap:
        the boxes are wrong, not the path."""
        known = self._passed.setdefault(path, {})
        if actor.uid not in known:
            known[actor.uid] = self._met(actor, path)
        return known[actor.uid]

    def _met(self, actor: Actor, path: ActorPath) -> frozenset[str]:
        length, width, _ = actor.size_m.tolist()
        boxes = self.standing.boxes
        sweep = swept([Way(path, 0.0, path.length_m, min(max(length / 4, 0.25), 1.0))])
        reach = boxes.radius_m + math.hypot(length, width) / 2
        # boxes about which the rectangle about the path is nowhere within reach
        inside = (boxes.x_m >= sweep.x_m.min() - reach) & (boxes.x_m <= sweep.x_m.max() + reach)
        inside &= (boxes.y_m >= sweep.y_m.min() - reach) & (boxes.y_m <= sweep.y_m.max() + reach)
        some = np.flatnonzero(inside)
        dx, dy = sweep.x_m[:, None] - boxes.x_m[some], sweep.y_m[:, None] - boxes.y_m[some]
        near = some[(dx * dx + dy * dy).min(0, initial=math.inf) <= reach[some] ** 2]
        if not len(near):
            return frozenset()
        half = length / 2, width / 2
        met = separations(sweep.x_m, sweep.y_m, sweep.heading_rad, half, boxes, near).min(0) <= 0
        uids = {self.standing.footprints[index].uid for index in near[met].tolist()}
        return frozenset(uids - {actor.uid})

    def generator(self, uid: str, draw: int) -> np.random.Generator:
        """Return the random generator of an actor's draw of that number, from the seed and its identifier."""
        return np.random.default_rng([self.seed, draw, *uid.encode()])

    @cached_property
    def paths(self) -> dict[str, ActorPath | None]:
        """The recorded path of every actor and of the ego vehicle, by identifier; None for what stands."""
        paths = {
            uid: ActorPath.recorded(actor.world_from_actor, *self.windows_s[uid], ends=actor.end_s < self.end_s)
            for uid, actor in self.actors.items()
        }
        end = self.end_s + FRAME_MARGIN_S
        paths[EGO] = ActorPath.recorded(self.world_from_ego_box, self.start_s - FRAME_MARGIN_S, end, ends=False)
        return paths

    @cached_property
    def lanes(self) -> dict[str, ActorPath]:
        """The paths that others can go on along, by identifier: those of all that moves as one piece."""
        return {
            uid: path
            for uid, path in self.paths.items()
            if path is not None and uid not in self.people and path.length_m >= LANE_LEAST_M
        }

    def continued(self, uid: str) -> ActorPath | None:
        """Return an actor's (or the ego's) recorded path, continued along other recorded paths where they pass its end."""
        if uid not in self._continued:
            path = self.paths[uid]
            self._continued[uid] = None if path is None else self._longer(uid, path)
        return self._continued[uid]

    def _longer(self, uid: str, path: ActorPath) -> ActorPath:
        used = {uid}
        while path.length_m < LANE_MOST_M and path.gear_at(path.length_m) > 0:
            continuation = self._further(path, used)
            if continuation is None:
                break
            used.add(continuation[0])
            path = path.then(continuation[1])
        return replace(path, ends=False)

    def _further(self, path: ActorPath, used: set[str]) -> tuple[str, ActorPath] | None:
        """Return the lane that goes on best from a path's end, and the path onto it."""
        position, quaternion = path.place(path.length_m)
        heading = float(yaw_of(np.array(quaternion)))
        best: tuple[float, str, float, float] | None = None
        for uid, lane in sorted(self.lanes.items()):
            if uid in used:
                continue
            s, left = lane.project(position[0], position[1])
            turn = abs(math.remainder(heading - float(lane.headings_at(np.array(s))), math.tau))
            fits = abs(left) <= LANE_ASIDE_M and turn <= LANE_TURN_RAD and lane.gear_at(s) > 0
            if fits and lane.length_m - s >= LANE_LEAST_M and s > 0:
                cost = abs(left) + 3 * turn
                best = min(best or (math.inf, "", 0.0, 0.0), (cost, uid, s, left))
        if best is None:
            return None
        _, uid, s, left = best
        length = max(10.0, 8 * abs(left), 2 * path.speed_at(path.length_m))
        onto = joined(self.lanes[uid], s, position, quaternion, length, keeps_height=True)
        return uid, replace(onto, stops=())  # when the other stood there is no reason to stand for this one

    def state(self, uid: str, time_us: int) -> ActorState:
        """Return an actor's recorded state: its pose has the bits of its trajectory's ``at(time_us / 1e6)``.

        Speed and acceleration are along the heading, from means over `SPEED_WINDOW_S` before and after.
        """
        time_s = time_us / US_PER_SECOND
        return self._state_of(uid, self.poses_at(time_s)[uid], time_s, 1.0)

    def poses_at(self, time_s: float) -> Mapping[str, tuple[Vector3, Quaternion]]:
        """Return where the recording has all actors at a time, by identifier, to the bits of their trajectories."""
        return self._poses.at(time_s)

    def state_at(self, uid: str, recorded_s: float, rate: float = 1.0) -> ActorState:
        """Return the state that the recording has at ``recorded_s``, of an actor that lives it at ``rate``."""
        position, quaternion = (part.tolist() for part in self.actors[uid].world_from_actor.placed_at(recorded_s))
        (x, y, z), (w, i, j, k) = position, quaternion
        return self._state_of(uid, ((x, y, z), (w, i, j, k)), recorded_s, rate)

    def _state_of(self, uid: str, pose: tuple[Vector3, Quaternion], recorded_s: float, rate: float) -> ActorState:
        start, end = self.windows_s[uid]
        w, i, j, k = pose[1]
        heading = math.atan2(2 * (i * j + w * k), 1 - 2 * (j * j + k * k))
        speed, acceleration = self._planes[uid].speed(recorded_s, heading, start, end)
        return ActorState(*pose, speed * rate, acceleration * rate, start <= recorded_s <= end)

    def strays(self, traffic: Traffic) -> Strays:
        """Return what is not where the recording has it."""
        if self._last and self._last[0][0] is traffic:  # every actor of a step asks for the same
            return self._last[0][1]
        time_s = traffic.time_us / US_PER_SECOND
        ego, uids = math.inf, []
        for footprint in traffic.footprints:
            x, y = self._planes[footprint.uid].at(time_s) if footprint.uid in self._planes else (math.inf, math.inf)
            apart = math.hypot(footprint.x_m - x, footprint.y_m - y)
            if footprint.uid == EGO:
                ego = apart
            if apart > STRAYED_M or (footprint.uid != EGO and not self._is_recorded(footprint.uid, time_s)):
                uids.append(footprint.uid)
        strays = Strays(ego, tuple(uids), traffic)
        self._last[:] = [(traffic, strays)]
        return strays

    def _is_recorded(self, uid: str, time_s: float) -> bool:
        start, end = self.windows_s.get(uid, (math.inf, -math.inf))
        return start <= time_s <= end

    def footprint(self, uid: str, time_us: int, like: Footprint) -> Footprint | None:
        """Return the recorded footprint of an actor or of the ego vehicle, of the size of ``like``; None where there is none."""
        time_s = time_us / US_PER_SECOND
        if uid == EGO:
            trajectory, window = self.world_from_ego_box, (self.start_s - FRAME_MARGIN_S, self.end_s + FRAME_MARGIN_S)
        elif self._is_recorded(uid, time_s):
            trajectory, window = self.actors[uid].world_from_actor, self.windows_s[uid]
        else:
            return None
        (x, y, _), quaternion = (part.tolist() for part in trajectory.placed_at(time_s))
        heading = float(yaw_of(np.array(quaternion)))
        speed, acceleration = self._planes[uid].speed(time_s, heading, *window)
        return Footprint(uid, like.label, x, y, heading, like.length_m, like.width_m, speed, acceleration)

    @cached_property
    def _poses(self) -> RecordedPoses:
        return RecordedPoses({uid: actor.world_from_actor for uid, actor in self.actors.items()})

    @cached_property
    def _planes(self) -> dict[str, _Plane]:
        trajectories = {uid: actor.world_from_actor for uid, actor in self.actors.items()}
        return {
            uid: _Plane.of(trajectory) for uid, trajectory in {**trajectories, EGO: self.world_from_ego_box}.items()
        }


@dataclass(frozen=True, eq=False)
class _Plane:
    """Places of a trajectory in the plane, as lists: faster for one time than arrays are."""

    times_s: list[float]
    places: list[list[float]]

    @staticmethod
    def of(trajectory: Trajectory) -> _Plane:
        places: FloatArray = trajectory.positions[:, :2]
        return _Plane(trajectory.times_s.tolist(), places.tolist())

    def at(self, time_s: float) -> tuple[float, float]:
        """Return the place at a time."""
        times, places = self.times_s, self.places
        if len(times) == 1:
            return places[0][0], places[0][1]
        upper = bisect_right(times, time_s, 1, len(times) - 1)
        before_s = times[upper - 1]
        u = (time_s - before_s) / (times[upper] - before_s)
        (ax, ay), (bx, by) = places[upper - 1], places[upper]
        return ax + u * (bx - ax), ay + u * (by - ay)

    def speed(self, time_s: float, heading_rad: float, start_s: float, end_s: float) -> tuple[float, float]:
        """Return speed and acceleration along a heading, from means over `SPEED_WINDOW_S` before and after, within two times."""
        now = min(max(time_s, start_s), end_s)
        before, after = max(now - SPEED_WINDOW_S, start_s), min(now + SPEED_WINDOW_S, end_s)
        if len(self.times_s) == 1 or before >= after:
            return 0.0, 0.0
        cos, sin = math.cos(heading_rad), math.sin(heading_rad)
        (x0, y0), (x1, y1), (x2, y2) = self.at(before), self.at(now), self.at(after)
        first, middle, last = x0 * cos + y0 * sin, x1 * cos + y1 * sin, x2 * cos + y2 * sin
        speed = (last - first) / (after - before)
        if speed <= 0 or not before < now < after:
            return max(speed, 0.0), 0.0
        change = (last - middle) / (after - now) - (middle - first) / (now - before)
        return speed, 2 * change / (after - before)
