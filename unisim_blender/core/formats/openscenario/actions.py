"""Actions of OpenSCENARIO: how each one is read, and what it does to entities when it starts.

A reader of an action takes all of its attributes at once; what it leaves is listed as not read. It returns a function that starts
the action for one entity at a time, and the function returns what runs then.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

from ...errors import ScenarioError, short
from .distances import distance_between
from .document import Document, NotUnderstoodError, XmlNode, innermost, read_child
from .entities import Entity, Hangs
from .motions import FASTEST_M_S, Arrives, Done, Dynamics, KeepsBeside, KeepsGap, Profile, Running, control
from .paths import Place
from .positions import Positions
from .routing import Routing, Start

if TYPE_CHECKING:
    from .storyboard import Storyboard

SHAPES = ("linear", "step", "sinusoidal", "cubic")
DIMENSIONS = ("time", "rate", "distance")
SYSTEMS = ("entity", "lane", "road", "trajectory")
UNSTATED_M_S2 = 10.0
UNSTATED_LATERAL_M_S2 = 1.0
"""Accelerations that an action leaves open."""


def _whole(start: Start) -> Start:
    """Return an action's start that leaves the entity as it was where the action turns out not to be understood."""

    def whole(entity: Entity, time_s: float) -> Running:
        before = entity.state()
        try:
            return start(entity, time_s)
        except Exception:
            entity.restore(before)
            raise

    return whole


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


class Actions:
    """Reads the actions of a file."""

    def __init__(self, document: Document, board: Storyboard) -> None:
        self.document, self.board = document, board
        self.positions = Positions(document, board)

    def private(self, node: XmlNode) -> Start:
        """Read a PrivateAction. Raises `NotUnderstoodError`."""
        routing = Routing(self.document, self.board, self.positions)
        readers: dict[tuple[str, ...], Callable[[XmlNode], Start]] = {
            ("TeleportAction",): self._teleport,
            ("LongitudinalAction", "SpeedAction"): self._speed,
            ("LongitudinalAction", "SpeedProfileAction"): self._profile,
            ("LongitudinalAction", "LongitudinalDistanceAction"): self._distance,
            ("LateralAction", "LaneChangeAction"): self._lane_change,
            ("LateralAction", "LaneOffsetAction"): self._lane_offset,
            ("LateralAction", "LateralDistanceAction"): self._beside,
            ("SynchronizeAction",): self._synchronize,
            ("RoutingAction", "FollowTrajectoryAction"): routing.trajectory,
            ("RoutingAction", "AssignRouteAction"): routing.route,
            ("RoutingAction", "AcquirePositionAction"): routing.acquire,
        }
        return _whole(read_child(node, readers))

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
                spot = locate(time_s)
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

    def _teleport(self, node: XmlNode) -> Start:
        locate = self.positions.position(node.required("Position"))

        def start(entity: Entity, time_s: float) -> Running:
            entity.put(locate(time_s), time_s)
            return Done()

        return start

    def _speed(self, node: XmlNode) -> Start:
        dynamics = dynamics_of(node.child("SpeedActionDynamics"), self.document)
        absolute = node.child("SpeedActionTarget", "AbsoluteTargetSpeed")
        relative = node.child("SpeedActionTarget", "RelativeTargetSpeed")
        if absolute is not None:
            steady = absolute.child("TargetDistanceSteadyState") or absolute.child("TargetTimeSteadyState")
            if steady is not None:
                raise NotUnderstoodError(steady.tag)
            return self._changes(dynamics, self._target_speed(absolute, None), False)
        if relative is None:
            raise NotUnderstoodError("SpeedAction without a target speed")
        target = self._target_speed(relative, self.board.entity(relative.text("entityRef")), "delta")
        return self._changes(dynamics, target, relative.truth("continuous", "false"))

    def _target_speed(self, node: XmlNode, other: Entity | None, default: str | None = None) -> Callable[[], float]:
        """Read a speed: one relative to another entity's where that is given."""
        value = node.number("value")
        if other is None:
            return lambda: value
        if node.choice("speedTargetValueType", ("delta", "factor"), default) == "factor":
            return lambda: other.speed(self.board.now_s) * value
        return lambda: other.speed(self.board.now_s) + value

    def _changes(self, dynamics: Dynamics, target: Callable[[], float], continuous: bool) -> Start:
        def start(entity: Entity, time_s: float) -> Running:
            self._drive(entity, "on its speed", "along", time_s)
            goal = target() if not continuous else 0.0
            change = dynamics.change(entity, time_s, entity.speed_m_s, target if continuous else lambda: goal, False)
            change.continuous = continuous
            if change.shape == "step" or change.takes_s <= 0:
                entity.speed_m_s = change.value(time_s)
            return control(entity, change, "longitudinal", time_s)

        return start

    def _drive(self, entity: Entity, what: str, where: str, time_s: float) -> None:
        """Have an entity drive along its path at a speed from now on."""
        if entity.timed is not None and time_s < float(entity.timed.times_s[-1]) - 1e-9:
            self.document.say(
                f"entity {short(entity.name)}: an action {what} ends its trajectory's times: it drives on {where} it"
            )
        entity.drive(time_s)

    def _profile(self, node: XmlNode) -> Start:
        followed = self.board.entity(node.text("entityRef")) if node.has("entityRef") else None
        if node.text("followingMode", "position") == "follow":
            self.document.say('SpeedProfileAction: followingMode="follow" is taken as "position"', node.place)
        entries = [
            (entry.number("speed"), entry.optional_number("time")) for entry in node.children("SpeedProfileEntry")
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

        def start(entity: Entity, time_s: float) -> Running:
            self._drive(entity, "on its speed", "along", time_s)
            base = 0.0 if followed is None else followed.speed(time_s)
            times, speeds = [time_s], [entity.speed_m_s]
            for speed, takes in entries:
                change = base + speed - speeds[-1]
                if takes is None:
                    takes = abs(change) / most[0 if change > 0 else 1]
                times.append(times[-1] + takes)
                speeds.append(base + speed)
            return control(entity, Profile(times, speeds), "longitudinal", time_s)

        return start

    def _distance(self, node: XmlNode) -> Start:
        other = self.board.entity(node.text("entityRef"))
        headway = node.optional_number("timeGap")
        length = node.optional_number("distance")
        if (headway is None) == (length is None):
            raise NotUnderstoodError("LongitudinalDistanceAction without one of distance and timeGap")
        freespace, continuous = node.truth("freespace", "false"), node.truth("continuous", "false")
        system = node.choice("coordinateSystem", SYSTEMS, "entity")
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

        def start(entity: Entity, time_s: float) -> Running:
            self._drive(entity, "on its speed", "along", time_s)

            def off(at_s: float) -> float | None:
                """How far ahead of its place beside the other one."""
                apart = distance_between(entity, other, "longitudinal", freespace, system, at_s)
                if apart is None:
                    return None
                wanted = length if length is not None else abs(entity.speed(at_s)) * (headway or 0.0)
                behind = side == "trailingReferencedEntity" or (side == "any" and apart >= 0)
                return apart - wanted if behind else apart + wanted

            if limits is not None:
                keeps = KeepsGap(entity, other, off, limits, continuous, time_s)
                return control(entity, keeps, "longitudinal", time_s)
            wrong = off(time_s)
            if wrong is not None and entity.curve is not None:
                entity.changed(time_s)
                entity.s_m += wrong
                entity.arrive(time_s)
            if wrong is None or not continuous:
                return Done()
            entity.speed_m_s = other.speed(time_s)
            return control(entity, Hangs(other, off), "longitudinal", time_s)

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
        absolute, relative = (node.child("FinalSpeed", tag) for tag in ("AbsoluteSpeed", "RelativeSpeedToMaster"))
        final, steady_m, steady_s = None, 0.0, 0.0
        speed = absolute or relative
        if speed is not None:
            final = self._target_speed(speed, None if relative is None else master)
            steady, lasting = speed.child("TargetDistanceSteadyState"), speed.child("TargetTimeSteadyState")
            steady_m = 0.0 if steady is None else steady.number("distance")
            steady_s = 0.0 if lasting is None else lasting.number("time")

        def start(entity: Entity, time_s: float) -> Running:
            self._drive(entity, "on its speed", "along", time_s)
            target, masters = goal(time_s).place, masters_goal(time_s).place

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
            return control(entity, arrives, "longitudinal", time_s)

        return start

    def _lane_change(self, node: XmlNode) -> Start:
        dynamics = dynamics_of(node.child("LaneChangeActionDynamics"), self.document)
        beside = node.number("targetLaneOffset", "0")
        absolute, relative = (
            node.child("LaneChangeTarget", tag) for tag in ("AbsoluteTargetLane", "RelativeTargetLane")
        )
        roads = self.board.roads
        if absolute is not None:
            name = absolute.text("value")
            try:
                lane = int(name)
            except ValueError:
                raise NotUnderstoodError(f"LaneChangeAction to the lane {short(name)}") from None
        elif relative is not None:
            other, lanes = self.board.entity(relative.text("entityRef")), relative.number("value")
        else:
            raise NotUnderstoodError("LaneChangeAction without a target lane")

        def start(entity: Entity, time_s: float) -> Running:
            self._drive(entity, "across its path", "beside", time_s)
            if absolute is not None:
                lane_m = roads.lane_on(entity, lane)
            else:
                lane_m = self.board.lane_beside(entity, other, lanes, time_s)
            running = self._across(entity, dynamics, lane_m + entity.road_sign * beside, time_s)
            entity.lane_left_m = lane_m
            roads.say_width()
            return running

        return start

    def _across(self, entity: Entity, dynamics: Dynamics, goal: float, time_s: float) -> Running:
        change = dynamics.change(entity, time_s, entity.left_m, lambda: goal, True)
        if change.done(time_s):
            entity.changed(time_s)
            entity.left_m, entity.lateral = goal, None
            entity.arrive(time_s)
            return Done()
        return control(entity, change, "lateral", time_s)

    def _beside(self, node: XmlNode) -> Start:
        other, continuous = self.board.entity(node.text("entityRef")), node.truth("continuous", "false")
        length = node.optional_number("distance")
        freespace = node.truth("freespace", "false")
        node.choice("coordinateSystem", SYSTEMS, "entity")
        side = node.choice("displacement", ("any", "leftToReferencedEntity", "rightToReferencedEntity"), "any")
        given = node.child("DynamicConstraints")
        fastest, *limits = (
            given.number(name) if given is not None and given.has(name) else math.inf
            for name in ("maxSpeed", "maxAcceleration", "maxDeceleration")
        )
        hardest = min(limits)

        def start(entity: Entity, time_s: float) -> Running:
            self._drive(entity, "across its path", "beside", time_s)
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
                aside = beside(at_s)
                return None if aside is None else aside + wanted

            if math.isinf(fastest) and math.isinf(hardest):
                entity.changed(time_s)
                entity.left_m = there + wanted
                entity.arrive(time_s)
            return control(entity, KeepsBeside(entity, goal, fastest, hardest, continuous, time_s), "lateral", time_s)

        return start

    def _lane_offset(self, node: XmlNode) -> Start:
        node.truth("continuous", "false")
        given = node.child("LaneOffsetActionDynamics")
        shape = "step" if given is None else given.choice("dynamicsShape", SHAPES)
        hardest = None if given is None else given.optional_number("maxLateralAcc")
        absolute, relative = (
            node.child("LaneOffsetTarget", tag) for tag in ("AbsoluteTargetLaneOffset", "RelativeTargetLaneOffset")
        )
        target = absolute or relative
        if target is None:
            raise NotUnderstoodError("LaneOffsetAction without a target")
        value = target.number("value")
        other = None if relative is None else self.board.entity(relative.text("entityRef"))
        if shape != "step" and hardest is None:
            self.document.say(
                f"LaneOffsetAction without maxLateralAcc: {UNSTATED_LATERAL_M_S2:g} m/s² are taken", node.place
            )

        def start(entity: Entity, time_s: float) -> Running:
            self._drive(entity, "across its path", "beside", time_s)
            beside = 0.0 if other is None else other.lane_offset_m
            goal = entity.lane_left_m + entity.road_sign * (value + beside)
            # a lateral acceleration is largest at both ends of a change
            away, most = abs(goal - entity.left_m), hardest or UNSTATED_LATERAL_M_S2
            takes = math.sqrt((6.0 if shape == "cubic" else math.pi**2 / 2) * away / max(most, 1e-3))
            return self._across(entity, Dynamics(shape, "time", takes), goal, time_s)

        return start
