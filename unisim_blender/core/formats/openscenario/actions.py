"""Actions of OpenSCENARIO: how each one is read, and what it does to entities when it starts.

A reader of an action takes all of its attributes at once; what it leaves is listed as not read. It returns a function that starts
the action for one entity at a time, and the function returns what runs then.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ...errors import ScenarioError, short
from ...geometry import FloatArray
from .document import Document, NotUnderstoodError, XmlNode, innermost
from .entities import Controller, Entity, Hangs, Spot, TimedPlaces
from .paths import TURN_S, Curve, Place, along_itself
from .positions import Positions

if TYPE_CHECKING:
    from .storyboard import Storyboard

SHAPES = ("linear", "step", "sinusoidal", "cubic")
DIMENSIONS = ("time", "rate", "distance")
FASTEST_M_S = 80.0
GAP_PER_S = 0.5
"""Of what a distance is wrong by, a controller makes up this part in a second."""
UNSTATED_M_S2 = 10.0
UNSTATED_LATERAL_M_S2 = 1.0
"""Accelerations that an action leaves open."""


class Running(Protocol):
    """An action that has started."""

    def done(self, time_s: float) -> bool:
        """Whether it has ended."""

    def stop(self, time_s: float) -> None:
        """End it."""


Start = Callable[["Storyboard", Entity, float], Running]


class Done:
    """An action that ends as it starts."""

    def done(self, time_s: float) -> bool:
        """Return True."""
        return True

    def stop(self, time_s: float) -> None:
        """Do nothing."""


@dataclass
class Controls:
    """An action that runs while its controller has the entity's speed, or its place across its path."""

    entity: Entity
    controller: Controller
    across: bool

    def done(self, time_s: float) -> bool:
        """Whether the controller is at its end, or another one has taken its place."""
        now = self.entity.lateral if self.across else self.entity.longitudinal
        return now is not self.controller

    def stop(self, time_s: float) -> None:
        """Take the controller away."""
        if not self.done(time_s):
            self.entity.changed(time_s)
            if self.across:
                self.entity.lateral = None
            else:
                self.entity.longitudinal = None


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


def _whole(start: Start) -> Start:
    """Return an action's start that leaves the entity as it was where the action turns out not to be understood."""

    def whole(board: Storyboard, entity: Entity, time_s: float) -> Running:
        before = entity.state()
        try:
            return start(board, entity, time_s)
        except Exception:
            entity.restore(before)
            raise

    return whole


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
        """Return the speed, or the place."""
        return self.start + (self.target() - self.start) * eased(self.shape, self._share(time_s))

    def done(self, time_s: float) -> bool:
        """Whether it is there."""
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


def dynamics_of(node: XmlNode | None, document: Document) -> Dynamics:
    """Return the dynamics of an action. Raises `NotUnderstoodError`."""
    if node is None:
        raise NotUnderstoodError("an action without dynamics")
    shape = node.choice("dynamicsShape", SHAPES)
    dimension = node.choice("dynamicsDimension", DIMENSIONS, "time")
    value = node.number("value", "0" if shape == "step" else None)
    if node.has("followingMode") and node.text("followingMode") == "follow":
        document.say(f'{node.tag}: followingMode="follow" is taken as "position"', node.place)
    return Dynamics(shape, dimension, value)


@dataclass(eq=False)
class Profile:
    """Speeds at times, linear between them."""

    times_s: list[float]
    speeds: list[float]

    def value(self, time_s: float) -> float:
        """Return the speed."""
        return float(np.interp(time_s, self.times_s, self.speeds))

    def done(self, time_s: float) -> bool:
        """Whether the last time is over."""
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
        """Return the speed."""
        accelerates, brakes, fastest = self.limits
        before_s, self.last_s = self.last_s, time_s
        off, now, step = self.off(before_s), self.entity.speed_m_s, time_s - before_s
        if off is None:
            return now
        wanted = min(self.other.speed(before_s) + GAP_PER_S * off, fastest)
        return max(min(wanted, now + accelerates * step), now - brakes * step, 0.0)

    def done(self, time_s: float) -> bool:
        """Whether the way is as long as it shall be."""
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
        """Return how far left of the path it is."""
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
        """Whether it is there."""
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
        """Return the speed."""
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
        """Whether both have arrived."""
        return self.over


class Actions:
    """Reads the actions of a file."""

    def __init__(self, document: Document, board: Storyboard) -> None:
        self.document, self.board = document, board
        self.positions = Positions(document, board)
        self._private: dict[tuple[str, ...], Callable[[XmlNode], Start]] = {
            ("TeleportAction",): self._teleport,
            ("LongitudinalAction", "SpeedAction"): self._speed,
            ("LongitudinalAction", "SpeedProfileAction"): self._profile,
            ("LongitudinalAction", "LongitudinalDistanceAction"): self._distance,
            ("LateralAction", "LaneChangeAction"): self._lane_change,
            ("LateralAction", "LaneOffsetAction"): self._lane_offset,
            ("LateralAction", "LateralDistanceAction"): self._beside,
            ("SynchronizeAction",): self._synchronize,
            ("RoutingAction", "FollowTrajectoryAction"): self._trajectory,
            ("RoutingAction", "AssignRouteAction"): self._route,
            ("RoutingAction", "AcquirePositionAction"): self._acquire,
        }

    def private(self, node: XmlNode) -> Start:
        """Read a PrivateAction. Raises `NotUnderstoodError`."""
        for tags, read in self._private.items():
            found = node.child(*tags)
            if found is not None:
                return _whole(read(found))
        raise NotUnderstoodError(innermost(node.element))

    def everybody(self, node: XmlNode) -> Callable[[float], None]:
        """Read a GlobalAction, or one like it, as a function that does it at a time. Raises `NotUnderstoodError`."""
        entity = node.child("EntityAction")
        if entity is not None:
            return self._entity(entity)
        for tag, values in (("Parameter", self.board.parameters), ("Variable", self.board.variables)):
            action = node.child(f"{tag}Action")
            if action is None:
                continue
            name = action.name_in(f"{tag[0].lower()}{tag[1:]}Ref")
            given, rule = action.child("SetAction"), action.child("ModifyAction", "Rule")
            if given is not None:
                value = given.text("value")
                return lambda time_s, values=values, name=name: values.update({name: value})  # type: ignore[misc]
            for kind in ("AddValue", "MultiplyByValue"):
                by = None if rule is None else rule.child(kind)
                if by is not None:
                    return self._modify(values, name, by.number("value"), kind == "AddValue")
        raise NotUnderstoodError(innermost(node.element))

    def _modify(self, values: dict[str, str], name: str, by: float, adds: bool) -> Callable[[float], None]:
        def modify(time_s: float) -> None:
            try:
                now = float(values.get(name, "0"))
            except ValueError:
                self.document.say(f"the value of {short(name)} is no number that could be modified")
                return
            values[name] = repr(now + by if adds else now * by)

        return modify

    def _entity(self, node: XmlNode) -> Callable[[float], None]:
        name, added = node.text("entityRef"), node.child("AddEntityAction", "Position")
        entity = self.board.entity(name)
        if added is not None:
            locate = self.positions.position(added)

            def add(time_s: float) -> None:
                spot = locate(self.board, time_s)
                if entity.is_there:
                    self.document.say(
                        f"entity {short(name)}: AddEntityAction at {time_s:.3g} s: it is there already, and is put elsewhere"
                    )
                else:
                    entity.appear(time_s, time_s <= self.board.span_s[0])
                entity.put(spot, time_s)

            return add
        if node.child("DeleteEntityAction") is None:
            raise NotUnderstoodError(innermost(node.element))

        def delete(time_s: float) -> None:
            if name == self.board.ego:
                self.document.say(
                    f"entity {short(name)}: DeleteEntityAction: the recording vehicle cannot vanish: it goes on as it was"
                )
            elif entity.is_there:
                entity.vanish(time_s)

        return delete

    # paths

    def _trajectory(self, node: XmlNode) -> Start:
        line = self.positions.line(node.child("TrajectoryRef") or node)
        closed, headless = line.closed, line.headless
        mode = node.child("TrajectoryFollowingMode") or node
        follows = mode.choice("followingMode", ("position", "follow"), "position") == "follow"
        timing, skips = node.child("TimeReference", "Timing"), node.number("initialDistanceOffset", "0")
        node.child("TimeReference", "None")
        if skips < 0:
            raise ScenarioError(f"{self.document.path}: {node.tag}: initialDistanceOffset must not be below 0")
        relative, scale, offset = True, 1.0, 0.0
        if timing is not None:
            relative = timing.choice("domainAbsoluteRelative", ("absolute", "relative")) == "relative"
            scale, offset = timing.number("scale"), timing.number("offset")
            if scale <= 0:
                raise ScenarioError(f"{self.document.path}: Timing: scale must be above 0, not {scale:g}")
        place = node.place

        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            places, own = line.places(board, entity, time_s)
            if headless and not follows and len(places) > 1:
                self.document.say(
                    'a WorldPosition without h has the heading 0 where followingMode is "position"', place
                )
            if timing is not None and own is None:
                raise NotUnderstoodError("FollowTrajectoryAction without times")
            if closed and len(places) > 1:
                places = np.concatenate([places, places[:1]])
            if timing is None or own is None:
                curve = Curve.through(places, follows)
                if curve is None:
                    entity.put(Spot(tuple(places[0].tolist())), time_s)
                    return Done()
                if closed:
                    self.document.say('Trajectory closed="true": it is driven back to its first vertex, once', place)
                if entity.carried(time_s) >= 0:
                    entity.follow(curve, skips, time_s)
                    return Follows(entity, curve)
                self.document.say(
                    f"entity {short(entity.name)}: its speed is negative as its trajectory begins: it drives along it in reverse"
                )
                entity.follow(curve.reversed(), curve.length_m - skips, time_s)
                return Follows(entity, curve.reversed(), True)
            times = (time_s if relative else 0.0) + offset + scale * own
            if closed and len(places) > 1:
                times = _closing(times, places)
                self.document.say(
                    'Trajectory closed="true": it is driven back to its first vertex at the speed of its last part',
                    place,
                )
            if skips:
                times, places, earlier = _skipped(times, places, skips)
                self.document.say(
                    f"initialDistanceOffset: it starts {skips:g} m along the trajectory, and is everywhere {earlier:g} s earlier",
                    place,
                )
            if follows and len(places) > 1:
                times, places = along_itself(times, places, TURN_S)
            timed = TimedPlaces(times, places)
            if times[0] > time_s + 1e-9:
                entity.pending = timed
                board.wake(float(times[0]))
            else:
                entity.keep_times(timed, time_s)
            return Follows(entity, timed)

        return start

    def _route(self, node: XmlNode) -> Start:
        route, reference = node.child("Route"), node.child("CatalogReference")
        if route is None and reference is not None:
            route = self.document.catalog_entry(reference)
        if route is None:
            raise NotUnderstoodError(node.tag)
        return self._drives_to(self.positions.waypoints(route), node)

    def _acquire(self, node: XmlNode) -> Start:
        position = node.child("Position")
        if position is None:
            raise NotUnderstoodError(node.tag)
        locate = self.positions.position(position)
        return self._drives_to(lambda board, time_s: np.array([locate(board, time_s).place]), node)

    def _drives_to(self, waypoints: Callable[[Storyboard, float], FloatArray], node: XmlNode) -> Start:
        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            places = waypoints(board, time_s)
            here = board.place(entity, time_s, node.tag)
            ahead = places
            if len(places) > 1:
                # what lies behind it is passed already
                line = Curve.through(places, True)
                s = 0.0 if line is None else line.project(here[0], here[1])[0]
                lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1))])
                ahead = places[lengths > s + 1e-6] if s > 0 else places
            curve = Curve.through(np.concatenate([np.array([here]), ahead]), True) if len(ahead) else None
            if curve is None:
                return Done()
            self.document.say(
                f"{node.tag}: it drives straight from waypoint to waypoint: no road network is read", node.place
            )
            entity.follow(curve, 0.0, time_s)
            return Follows(entity, curve)

        return start

    def _teleport(self, node: XmlNode) -> Start:
        position = node.child("Position")
        if position is None:
            raise ScenarioError(f"{self.document.path}: TeleportAction: has no Position")
        locate = self.positions.position(position)

        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            entity.put(locate(board, time_s), time_s)
            return Done()

        return start

    # speeds

    def _speed(self, node: XmlNode) -> Start:
        dynamics = dynamics_of(node.child("SpeedActionDynamics"), self.document)
        absolute = node.child("SpeedActionTarget", "AbsoluteTargetSpeed")
        relative = node.child("SpeedActionTarget", "RelativeTargetSpeed")
        if absolute is not None:
            value = absolute.number("value")
            steady = absolute.child("TargetDistanceSteadyState") or absolute.child("TargetTimeSteadyState")
            if steady is not None:
                raise NotUnderstoodError(steady.tag)
            return self._changes(dynamics, lambda: value, False)
        if relative is None:
            raise NotUnderstoodError("SpeedAction without a target speed")
        other, by = self.board.entity(relative.text("entityRef")), relative.number("value")
        factor = relative.choice("speedTargetValueType", ("delta", "factor"), "delta") == "factor"
        continuous = relative.truth("continuous", "false")

        def target() -> float:
            speed = other.speed(self.board.now_s)
            return speed * by if factor else speed + by

        return self._changes(dynamics, target, continuous)

    def _changes(self, dynamics: Dynamics, target: Callable[[], float], continuous: bool) -> Start:
        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            self._take_over(entity, time_s)
            goal = target() if not continuous else 0.0
            change = dynamics.change(entity, time_s, entity.speed_m_s, target if continuous else lambda: goal, False)
            change.continuous = continuous
            if change.shape == "step" or change.takes_s <= 0:
                entity.speed_m_s = change.value(time_s)
            return self._control(entity, change, time_s)

        return start

    def _take_over(self, entity: Entity, time_s: float) -> None:
        """Have an entity be driven at a speed from now on."""
        if entity.timed is not None and time_s < float(entity.timed.times_s[-1]) - 1e-9:
            self.document.say(
                f"entity {short(entity.name)}: an action on its speed ends its trajectory's times: it drives on along it"
            )
        entity.drive(time_s)

    def _control(self, entity: Entity, controller: Controller, time_s: float) -> Running:
        if controller.done(time_s):
            entity.longitudinal = None
            return Done()
        entity.longitudinal = controller
        return Controls(entity, controller, False)

    def _profile(self, node: XmlNode) -> Start:
        followed = self.board.entity(node.text("entityRef")) if node.has("entityRef") else None
        if node.text("followingMode", "position") == "follow":
            self.document.say('SpeedProfileAction: followingMode="follow" is taken as "position"', node.place)
        entries = [
            (one.number("speed"), one.number("time") if one.has("time") else None)
            for one in node.children("SpeedProfileEntry")
        ]
        if not entries:
            raise NotUnderstoodError("SpeedProfileAction without an entry")
        most = (0.0, 0.0)
        if any(takes is None for _, takes in entries):
            given = node.child("DynamicConstraints")
            if given is None:
                raise NotUnderstoodError("SpeedProfileAction without times or DynamicConstraints")
            most = given.number("maxAcceleration"), given.number("maxDeceleration")
            if min(most) <= 0:
                raise ScenarioError(f"{self.document.path}: DynamicConstraints: accelerations must be above 0")

        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            self._take_over(entity, time_s)
            base = 0.0 if followed is None else followed.speed(time_s)
            times, speeds = [time_s], [entity.speed_m_s]
            for speed, takes in entries:
                change = base + speed - speeds[-1]
                if takes is None:
                    takes = abs(change) / most[0 if change > 0 else 1]
                times.append(times[-1] + takes)
                speeds.append(base + speed)
            return self._control(entity, Profile(times, speeds), time_s)

        return start

    def _distance(self, node: XmlNode) -> Start:
        other = self.board.entity(node.text("entityRef"))
        headway = node.number("timeGap") if node.has("timeGap") else None
        length = node.number("distance") if node.has("distance") else None
        if (headway is None) == (length is None):
            raise NotUnderstoodError("LongitudinalDistanceAction without one of distance and timeGap")
        freespace, continuous = node.truth("freespace", "false"), node.truth("continuous", "false")
        system = node.choice("coordinateSystem", ("entity", "lane", "road", "trajectory"), "entity")
        # a box may be turned from where it drives
        system = "ahead" if system == "entity" else system
        side = node.choice(
            "displacement", ("any", "trailingReferencedEntity", "leadingReferencedEntity"), "trailingReferencedEntity"
        )
        given = node.child("DynamicConstraints")
        limits = None
        if given is not None:
            limits = (
                given.number("maxAcceleration", repr(UNSTATED_M_S2)),
                given.number("maxDeceleration", repr(UNSTATED_M_S2)),
                given.number("maxSpeed", repr(FASTEST_M_S)),
            )

        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            self._take_over(entity, time_s)

            def off(at_s: float) -> float | None:
                """How far ahead of its place beside the other one."""
                found = board.gap(entity, other, "longitudinal", freespace, system, at_s)
                if found is None:
                    return None
                wanted = length if length is not None else abs(entity.speed(at_s)) * (headway or 0.0)
                behind = side == "trailingReferencedEntity" or (side == "any" and found >= 0)
                return found - wanted if behind else found + wanted

            if limits is not None:
                return self._control(entity, KeepsGap(entity, other, off, limits, continuous, time_s), time_s)
            wrong = off(time_s)
            if wrong is not None and entity.curve is not None:
                entity.changed(time_s)
                entity.s_m += wrong
                entity.arrive(time_s)
            if not continuous:
                return Done()
            if wrong is None:
                return Done()
            entity.speed_m_s = other.speed(time_s)
            return self._control(entity, Hangs(other, off), time_s)

        return start

    def _synchronize(self, node: XmlNode) -> Start:
        master = self.board.entity(node.text("masterEntityRef"))
        there, own = node.child("TargetPositionMaster"), node.child("TargetPosition")
        if there is None or own is None:
            raise NotUnderstoodError("SynchronizeAction without two positions")
        for name in ("targetTolerance", "targetToleranceMaster"):
            if node.has(name):
                node.number(name)
                self.document.say(f"SynchronizeAction: {name} is taken as 0", node.place)
        goal, masters_goal = self.positions.position(own), self.positions.position(there)
        absolute, relative = (
            node.child("FinalSpeed", "AbsoluteSpeed"),
            node.child("FinalSpeed", "RelativeSpeedToMaster"),
        )
        final, steady_m, steady_s = None, 0.0, 0.0
        speed = absolute or relative
        if speed is not None:
            value = speed.number("value")
            steady, lasting = speed.child("TargetDistanceSteadyState"), speed.child("TargetTimeSteadyState")
            steady_m = 0.0 if steady is None else steady.number("distance")
            steady_s = 0.0 if lasting is None else lasting.number("time")
            if relative is None:
                final = lambda: value  # noqa: E731
            elif relative.choice("speedTargetValueType", ("delta", "factor")) == "factor":
                final = lambda: value * master.speed(self.board.now_s)  # noqa: E731
            else:
                final = lambda: value + master.speed(self.board.now_s)  # noqa: E731

        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            self._take_over(entity, time_s)
            target, masters = goal(board, time_s).place, masters_goal(board, time_s).place

            def left(who: Entity, place: Place, at_s: float) -> float | None:
                path = who.on_path(at_s)
                if path is None:
                    return None
                curve, s, _ = path
                return curve.project(place[0], place[1])[0] - s

            def takes(at_s: float) -> float | None:
                way, velocity = left(master, masters, at_s), master.speed(at_s)
                if way is None or abs(way) <= 0.05:
                    return 0.0
                # who backs comes to what lies behind it
                return max(way / velocity, 0.0) if abs(velocity) > 0.01 else None

            way = left(entity, target, time_s)
            if way is not None and way <= 0:
                name = short(entity.name)
                self.document.say(
                    f"SynchronizeAction at {time_s:.3g} s: entity {name} is past its TargetPosition: it ends at once"
                )
            arrives = Arrives(entity, lambda at_s: left(entity, target, at_s), takes, final, steady_m, steady_s, time_s)
            entity.longitudinal = arrives
            return Controls(entity, arrives, False)

        return start

    # across the path

    def _lane_change(self, node: XmlNode) -> Start:
        dynamics = dynamics_of(node.child("LaneChangeActionDynamics"), self.document)
        beside = node.number("targetLaneOffset", "0")
        absolute, relative = (
            node.child("LaneChangeTarget", "AbsoluteTargetLane"),
            node.child("LaneChangeTarget", "RelativeTargetLane"),
        )
        if absolute is not None:
            name = absolute.text("value")
            try:
                lane = int(name)
            except ValueError:
                raise NotUnderstoodError(f"LaneChangeAction to the lane {short(name)}") from None

            def target(board: Storyboard, entity: Entity, time_s: float) -> float:
                return board.lane_on(entity, lane)

        elif relative is not None:
            other, lanes = self.board.entity(relative.text("entityRef")), relative.number("value")

            def target(board: Storyboard, entity: Entity, time_s: float) -> float:
                return board.lane_beside(entity, other, lanes, time_s)

        else:
            raise NotUnderstoodError("LaneChangeAction without a target lane")

        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            self._steer(entity, time_s)
            lane_m = target(board, entity, time_s)
            goal = lane_m + entity.road_sign * beside
            running = self._across(entity, dynamics, goal, time_s)
            entity.lane_left_m = lane_m
            board.say_width(node)
            return running

        return start

    def _steer(self, entity: Entity, time_s: float) -> None:
        """Have an entity be moved across its path from now on."""
        if entity.timed is not None and time_s < float(entity.timed.times_s[-1]) - 1e-9:
            self.document.say(
                f"entity {short(entity.name)}: an action across its path ends its trajectory's times: it drives on beside it"
            )
        entity.drive(time_s)

    def _across(self, entity: Entity, dynamics: Dynamics, goal: float, time_s: float) -> Running:
        change = dynamics.change(entity, time_s, entity.left_m, lambda: goal, True)
        if change.done(time_s):
            entity.changed(time_s)
            entity.left_m, entity.lateral = goal, None
            entity.arrive(time_s)
            return Done()
        entity.lateral = change
        return Controls(entity, change, True)

    def _beside(self, node: XmlNode) -> Start:
        other, continuous = self.board.entity(node.text("entityRef")), node.truth("continuous", "false")
        length = node.number("distance") if node.has("distance") else None
        freespace = node.truth("freespace", "false")
        node.choice("coordinateSystem", ("entity", "lane", "road", "trajectory"), "entity")
        side = node.choice("displacement", ("any", "leftToReferencedEntity", "rightToReferencedEntity"), "any")
        given = node.child("DynamicConstraints")
        fastest, *limits = (
            given.number(name) if given is not None and given.has(name) else math.inf
            for name in ("maxSpeed", "maxAcceleration", "maxDeceleration")
        )
        hardest = min(limits)

        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            self._steer(entity, time_s)
            apart = (entity.size_m[1] + other.size_m[1]) / 2 if freespace else 0.0

            def beside(at_s: float) -> float | None:
                """How far left of the path the other one is."""
                place = other.place(at_s)
                if place is None or entity.curve is None:
                    return None
                return entity.curve.project(place[0], place[1])[1]

            there = beside(time_s)
            if there is None:
                raise NotUnderstoodError(f"LateralDistanceAction (the place of {short(other.name)} is not known)")
            now = entity.left_m - there
            left = side == "leftToReferencedEntity" or (side == "any" and now >= 0)
            wanted = now if length is None else length + apart if left else -length - apart

            def goal(at_s: float) -> float | None:
                found = beside(at_s)
                return None if found is None else found + wanted

            if math.isinf(fastest) and math.isinf(hardest):
                entity.changed(time_s)
                entity.left_m = there + wanted
                entity.arrive(time_s)
            controller = KeepsBeside(entity, goal, fastest, hardest, continuous, time_s)
            if controller.done(time_s):
                entity.lateral = None
                return Done()
            entity.lateral = controller
            return Controls(entity, controller, True)

        return start

    def _lane_offset(self, node: XmlNode) -> Start:
        node.truth("continuous", "false")
        given = node.child("LaneOffsetActionDynamics")
        shape = "step" if given is None else given.choice("dynamicsShape", SHAPES)
        hardest = given.number("maxLateralAcc") if given is not None and given.has("maxLateralAcc") else None
        absolute = node.child("LaneOffsetTarget", "AbsoluteTargetLaneOffset")
        relative = node.child("LaneOffsetTarget", "RelativeTargetLaneOffset")
        target = absolute or relative
        if target is None:
            raise NotUnderstoodError("LaneOffsetAction without a target")
        value = target.number("value")
        other = None if relative is None else self.board.entity(relative.text("entityRef"))
        if shape != "step" and hardest is None:
            self.document.say(
                f"LaneOffsetAction without maxLateralAcc: {UNSTATED_LATERAL_M_S2:g} m/s² are taken", node.place
            )

        def start(board: Storyboard, entity: Entity, time_s: float) -> Running:
            self._steer(entity, time_s)
            beside = 0.0 if other is None else board.offset_of(other, time_s)
            goal = entity.lane_left_m + entity.road_sign * (value + beside)
            # a lateral acceleration is largest at both ends of a change
            away, most = abs(goal - entity.left_m), hardest or UNSTATED_LATERAL_M_S2
            takes = math.sqrt((6.0 if shape == "cubic" else math.pi**2 / 2) * away / max(most, 1e-3))
            return self._across(entity, Dynamics(shape, "time", takes), goal, time_s)

        return start


def _closing(times: FloatArray, places: FloatArray) -> FloatArray:
    """Return times with that of the way back from the last vertex to the first, at the speed of the part before it."""
    lengths = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
    speeds = lengths[:-1] / np.diff(times) if len(times) > 1 else np.array([1.0])
    moving = speeds[speeds > 1e-6]
    return np.append(times, times[-1] + max(float(lengths[-1]), 1e-3) / (float(moving[-1]) if len(moving) else 1.0))


def _skipped(times: FloatArray, places: FloatArray, length_m: float) -> tuple[FloatArray, FloatArray, float]:
    """Return a trajectory that starts so far along itself at its first time, and how much earlier it is everywhere."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1))])
    if length_m >= along[-1]:
        return times[:1], places[-1:], float(times[-1] - times[0])
    part = int(np.searchsorted(along, length_m, side="right")) - 1
    share = (length_m - along[part]) / (along[part + 1] - along[part])
    first = places[part] + share * (places[part + 1] - places[part])
    began = float(times[part] + share * (times[part + 1] - times[part]))
    earlier = began - float(times[0])
    return (
        np.concatenate([[began], times[part + 1 :]]) - earlier,
        np.concatenate([[first], places[part + 1 :]]),
        earlier,
    )
