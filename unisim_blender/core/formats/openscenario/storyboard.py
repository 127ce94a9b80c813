"""The storyboard of an OpenSCENARIO file, worked out in time: which events start when, and where each entity is until the end.

Of a road network only the side that traffic keeps to is read. A recorded path stands for the one road that positions in lanes
name; whatever needs another one is said.
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from ...errors import ScenarioError, short
from ...geometry import FloatArray, Trajectory
from .actions import Actions, Running, Start
from .conditions import Conditions, Trigger, boxes_apart
from .document import Document, NotUnderstoodError, XmlNode, xml_root
from .entities import ALONG_RAD, STEP_S, Entity, Track
from .expressions import ExpressionError, text_of
from .paths import LANE_WIDTH_M, Curve, Lanes, Place, lane_left

MOST_PASSES = 50
"""At one time, events that start others are worked out so often."""
MOST_ENTITIES = 10_000
NEAR_M, OFF_GROUND_M = 20.0, 0.3
"""Distances, metres: a position this near to a recorded path, and this far above or below it, is not on the ground."""
Size = tuple[float, float, float]
Described = Callable[[str, Size | None, float | None], tuple[Size, Size, Trajectory | None]]
"""Gives by an entity's name the middle of its box from its reference point, which is given with the box's height where the file
says them, the log's size of the box, and the recorded trajectory of the point."""


class NotPlacedYetError(Exception):
    """A place beside an entity that has none yet."""


@dataclass(eq=False)
class Element:
    """A part of the storyboard that starts and ends."""

    kind: str
    name: str
    parent: Element | None = None
    children: list[Element] = field(default_factory=list)
    state: str = "standby"
    began: int = -9
    ended: int = -9
    was_stopped: bool = False

    def path(self) -> list[str]:
        """Return its names from the story down."""
        return [*([] if self.parent is None else self.parent.path()), self.name]


@dataclass(eq=False)
class Event(Element):
    """An event: what it does, to whom, and what starts it."""

    trigger: Trigger = field(default_factory=lambda: Trigger([], True))
    starts: list[tuple[Element, str, Callable[[float], list[Running]]]] = field(default_factory=list)
    running: list[tuple[Element, Running]] = field(default_factory=list)
    priority: str = "parallel"
    most: int = 1
    count: int = 0


@dataclass(eq=False)
class Act(Element):
    """An act, with what starts and what stops it."""

    start: Trigger = field(default_factory=lambda: Trigger([], True))
    stop: Trigger = field(default_factory=lambda: Trigger([], False))
    events: list[Event] = field(default_factory=list)


class Storyboard:
    """The storyboard of a document between two times. Raises `ScenarioError` for what is not valid."""

    def __init__(self, document: Document, span_s: tuple[float, float], ego: str | None, describe: Described) -> None:
        self.document, self.span_s, self.now_s, self.ego = document, span_s, span_s[0], ego
        self.needs_steps = False
        self.entities: dict[str, Entity] = {}
        self._ticks = [span_s[0], span_s[1]]
        self._tick = 0
        self._lanes: Lanes | None = None
        self._elements: list[Element] = []
        self._reached: set[tuple[str, str]] = set()
        self._awaited: set[str] = set()
        self._homeless: list[Entity] = []
        root = document.node.declaring()
        self.parameters = {name: str(root.scope.own[name]) for name in root.scope.own}
        for name in self.parameters:
            try:
                self.parameters[name] = _as_text(root, name)
            except NotUnderstoodError as fault:
                document.say(f"{fault} is not understood")
        self.variables = {
            one.text("name"): one.text("value")
            for holder in root.children("VariableDeclarations")
            for one in holder.children("VariableDeclaration")
        }
        self.actions = Actions(document, self)
        self.conditions = Conditions(document, self, self.actions.positions)
        self._read_entities(root, describe)
        self._network = root.child("RoadNetwork")
        self._left_hand: frozenset[str] | None = None
        board = root.child("Storyboard")
        if board is None:
            other = next((one for one in ("ParameterValueDistribution", "Catalog") if root.child(one)), None)
            instead = "" if other is None else f": it is a {other}, which goes with a scenario"
            raise ScenarioError(f"{document.path}: has no Storyboard{instead}")
        self._init = self._read_init(board)
        self._anchor(ego)
        self._acts = [act for story in board.children("Story") for act in self._story(story)]
        self._stop = self.conditions.trigger(board.child("StopTrigger"), "Storyboard: StopTrigger", False)
        self.stops_s: float | None = None
        every = board.element.iter("EntityAction")
        added = {one.get("entityRef", "") for one in every if one.find("AddEntityAction") is not None}
        starts = board.element.findall("Init/Actions/Private")
        placed = {one.get("entityRef", "") for one in starts if one.find("PrivateAction/TeleportAction") is not None}
        for name, entity in self.entities.items():
            given = {name, *(f"${key}" for key, value in self.parameters.items() if value == name)}
            if given & added and not given & placed and name != ego:
                entity.is_there = False

    # what is read

    def _read_entities(self, root: XmlNode, describe: Described) -> None:
        holder = root.child("Entities")
        for one in [] if holder is None else holder.children("ScenarioObject"):
            name = one.text("name")
            if name in self.entities:
                raise ScenarioError(f"{self.document.path}: Entities: two are named {short(name)}")
            if len(self.entities) == MOST_ENTITIES:
                raise ScenarioError(f"{self.document.path}: Entities: more than {MOST_ENTITIES}")
            kind = next((found for tag in ("Vehicle", "Pedestrian", "MiscObject") if (found := one.child(tag))), None)
            reference = one.child("CatalogReference")
            if reference is not None:
                try:
                    kind = self.document.catalog_entry(reference)
                except NotUnderstoodError as fault:
                    self.document.say(f"{fault}: the box of the log's actor is taken", f"entity {short(name)}")
            middle = size = None
            if kind is not None:
                kind = kind.declaring()
                middle, size = kind.child("BoundingBox", "Center"), kind.child("BoundingBox", "Dimensions")
                if middle is None:
                    self.document.say("has no bounding box: that of the log's actor is taken", f"entity {short(name)}")
            given = None
            if middle is not None:
                given = middle.number("x"), middle.number("y"), middle.number("z")
            height = None if size is None else size.number("height")
            centre, measures, recorded = describe(name, given, height)
            if size is not None:
                measures = size.number("length"), size.number("width"), size.number("height")
            self.entities[name] = Entity(name, centre, measures, recorded, self.span_s, size is not None)
        for one in [] if holder is None else holder.children("EntitySelection"):
            self.document.say(f"entities: the selection {short(one.element.get('name', ''))} is not understood")
            one.settled()

    def entity(self, name: str) -> Entity:
        """Return an entity by its name. Raises `ScenarioError`."""
        if name not in self.entities:
            raise ScenarioError(f"{self.document.path}: entityRef: there is no entity {short(name)}")
        return self.entities[name]

    def _read_init(self, board: XmlNode) -> list[tuple[str, Entity | None, Callable[[float], object], bool]]:
        """Return what Init does: its place, the entity, and what to call; True for what puts an entity somewhere."""
        found: list[tuple[str, Entity | None, Callable[[float], object], bool]] = []
        actions = board.child("Init", "Actions")
        for private in [] if actions is None else actions.children():
            if private.tag != "Private":
                self._try(private.at("Init"), lambda node: found.append(self._at_start(node)))
                continue
            name = private.text("entityRef")
            entity = self.entity(name)
            self.actions.positions.owner = name
            for action in private.at(f"Init: {name}").children():
                if not self._try(action, lambda node, entity=entity: found.append(self._own_start(node, entity))):  # type: ignore[misc]
                    self._not_placed(action, entity)
            self.actions.positions.owner = None
        return found

    def _at_start(self, node: XmlNode) -> tuple[str, Entity | None, Callable[[float], object], bool]:
        return node.place, None, self.actions.everybody(node), False

    def _own_start(self, node: XmlNode, entity: Entity) -> tuple[str, Entity | None, Callable[[float], object], bool]:
        start = self.actions.private(node)
        return node.place, entity, lambda time_s: start(self, entity, time_s), node.child("TeleportAction") is not None

    def _try(self, node: XmlNode, read: Callable[[XmlNode], object]) -> bool:
        """Read an element, or say that it is not understood; whether it was."""
        try:
            read(node)
        except NotUnderstoodError as fault:
            self.document.say(f"{fault} is not understood", node.place)
            node.settled()
            return False
        return True

    def _not_placed(self, action: XmlNode, entity: Entity) -> None:
        if action.child("TeleportAction") is not None or action.child("RoutingAction") is not None:
            self._homeless.append(entity)

    def _story(self, story: XmlNode) -> Iterator[Act]:
        story = story.declaring()
        # stories run from the start
        whole = Element("story", _name(story), state="running", began=0)
        self._elements.append(whole)
        for node in story.children("Act"):
            node = node.declaring()
            place = f"{_name(story)}/{_name(node)}"
            start = self.conditions.trigger(node.child("StartTrigger"), f"{place}: StartTrigger", True)
            stop = self.conditions.trigger(node.child("StopTrigger"), f"{place}: StopTrigger", False)
            act = Act("act", _name(node), whole, start=start, stop=stop)
            whole.children.append(act)
            self._elements.append(act)
            for group in node.children("ManeuverGroup"):
                self._group(group, act, place)
            yield act

    def _group(self, node: XmlNode, act: Act, place: str) -> None:
        group = Element("maneuverGroup", _name(node), act)
        act.children.append(group)
        self._elements.append(group)
        if node.has("maximumExecutionCount") and node.number("maximumExecutionCount") != 1:
            self.document.say("ManeuverGroup: maximumExecutionCount is taken as 1", place)
        holder = node.child("Actors")
        entities = []
        if holder is not None:
            if holder.truth("selectTriggeringEntities", "false"):
                self.document.say("Actors: selectTriggeringEntities is not understood: those that are named act", place)
            entities = [self.entity(one.text("entityRef")) for one in holder.children("EntityRef")]
        maneuvers = [one.declaring() for one in node.children("Maneuver")]
        for reference in node.children("CatalogReference"):
            try:
                maneuvers.append(self.document.catalog_entry(reference))
            except NotUnderstoodError as fault:
                self.document.say(f"{fault} is not understood", f"{place}/{_name(node)}")
                reference.settled()
        for one in maneuvers:
            maneuver = Element("maneuver", _name(one), group)
            group.children.append(maneuver)
            self._elements.append(maneuver)
            for event in one.children("Event"):
                act.events.append(self._event(event, maneuver, entities, place))

    def _event(self, node: XmlNode, maneuver: Element, entities: list[Entity], place: str) -> Event:
        here = f"{place}/{_name(node)}"
        trigger = self.conditions.trigger(node.child("StartTrigger"), f"{here}: StartTrigger", True)
        priority = node.text("priority", "parallel")
        most = int(node.number("maximumExecutionCount", "1"))
        event = Event("event", _name(node), maneuver, trigger=trigger, priority=priority, most=max(most, 1))
        maneuver.children.append(event)
        self._elements.append(event)
        for one in node.children("Action"):
            action = Element("action", _name(one), event)
            self._elements.append(action)
            event.children.append(action)
            for kind in one.at(f"{here}/{_name(one)}").children():
                self._try(kind, lambda kind, action=action: self._action(kind, event, action, entities))  # type: ignore[misc]
        return event

    def _action(self, node: XmlNode, event: Event, action: Element, entities: list[Entity]) -> None:
        if node.tag != "PrivateAction":
            act = self.actions.everybody(node)

            def run(time_s: float) -> list[Running]:
                act(time_s)
                return []

            event.starts.append((action, node.place, run))
            return
        start: Start = self.actions.private(node)
        timed = node.child("RoutingAction", "FollowTrajectoryAction", "TimeReference", "Timing")
        # all other motions are worked out step by step
        self.needs_steps |= timed is None and node.child("TeleportAction") is None

        def run_own(time_s: float) -> list[Running]:
            return [start(self, one, time_s) for one in entities if one.is_there]

        event.starts.append((action, node.place, run_own))

    # roads

    def _anchor(self, ego: str | None) -> None:
        """Choose the recorded path that stands for a road: the ego vehicle's, or that of the first entity that has one."""
        every = self.actions.positions.on_roads
        known = [one for one in every if self.entities[one.entity].recorded is not None]
        if not known:
            return
        start = min(known, key=lambda one: one.entity != ego)
        entity = self.entities[start.entity]
        curve = entity.recorded_curve
        if curve is None:
            place = entity.place(self.span_s[0])
            assert place is not None  # it was recorded
            curve = Curve.straight(place)
        heading = curve.at(0.0)[3] if start.heading is None else start.heading
        self._lanes = Lanes(curve, start.road, start.s_m, start.left_m, start.side, heading)
        side = "left" if start.road in self._left_hand_roads() else "right"
        self.document.say(
            f"no road network is read: the recorded path of {short(entity.name)} stands for road {short(start.road)}, its "
            f"start for s = {start.s_m:g} m and {start.left_m:g} m left of the road's line; lanes are {LANE_WIDTH_M:g} m wide, "
            f"traffic keeps to the {side}"
        )

    def _left_hand_roads(self) -> frozenset[str]:
        """Return the roads whose traffic keeps to the left; none where the road network cannot be read, which is said."""
        if self._left_hand is None:
            self._left_hand = frozenset()
            file = None if self._network is None else self._network.child("LogicFile")
            if file is not None:
                try:
                    roads = xml_root(self.document.path.parent / file.text("filepath")).iter("road")
                    self._left_hand = frozenset(one.get("id", "") for one in roads if one.get("rule") == "LHT")
                except (ScenarioError, NotUnderstoodError) as fault:
                    self.document.say(f"RoadNetwork: LogicFile: {fault}: traffic is taken to keep to the right")
        return self._left_hand

    def traffic(self, road: str, left_m: float) -> int:
        """Return 1 where the traffic of a road runs along it so far left of its reference line, else -1."""
        along = left_m == 0 or (left_m > 0) == (road in self._left_hand_roads())
        return 1 if along else -1

    def is_against_traffic(self, curve: Curve, lane_left_m: float, sign: int) -> bool:
        """Whether who drives along a path drives against the traffic of its lane, whose middle lies so far left of the path;
        ``sign`` is -1 where the path runs against its road."""
        lanes = self._lanes
        if lanes is None or curve not in (lanes.curve, lanes.curve.reversed()):
            return False
        return sign != self.traffic(lanes.road, lanes.road_left(lane_left_m if curve is lanes.curve else -lane_left_m))

    def lanes_of(self, road: str, tag: str) -> Lanes:
        """Return the lanes of a road. Raises `NotUnderstoodError` where no recorded path stands for it."""
        if self._lanes is None:
            raise NotUnderstoodError(f"{tag} (it needs a road network: no recorded path stands for road {short(road)})")
        if self._lanes.road != road:
            raise NotUnderstoodError(
                f"{tag} on road {short(road)} (it needs a road network: a recorded path stands for road "
                f"{short(self._lanes.road)} alone)"
            )
        return self._lanes

    def turned(self, curve: Curve, s_m: float, heading: float, node: XmlNode) -> float:
        """Return by how much a heading of the file's world is turned from a path at an arc length. A path that stands for a road
        is elsewhere in the file's world: a heading near the road's at its anchor, or against it, is along the path."""
        lanes = self._lanes
        if lanes is None or curve not in (lanes.curve, lanes.curve.reversed()):
            return math.remainder(heading - curve.at(s_m)[3], math.tau)
        off = math.remainder(heading - lanes.heading - (0.0 if curve is lanes.curve else math.pi), math.tau)
        for whole in (0.0, math.pi, -math.pi):
            if abs(off - whole) <= ALONG_RAD:
                return whole
        if self._first(node, "heading"):
            self.document.say(
                f"{node.tag}: its absolute heading is {math.degrees(off):.0f}° off that of the traffic where road "
                f"{short(lanes.road)} is anchored: it is turned by as much from the recorded path",
                node.place,
            )
        return off

    def _first(self, node: XmlNode, what: str) -> bool:
        """Whether this is asked for the first time of an element's place in the file."""
        key = f"{node.place} {node.tag}", what
        known = key in self._reached
        self._reached.add(key)
        return not known

    def check_reach(self, curve: Curve, s_m: float, node: XmlNode) -> None:
        """Say where a position lies before the start of a recorded path, or beyond its end."""
        beyond = max(-s_m, s_m - curve.length_m)
        if curve.headed and beyond > 1.0 and self._first(node, "reach"):
            where = "before the start of" if (s_m < 0) != curve.backward else "beyond the end of"
            self.document.say(
                f"{node.tag}: lies {beyond:.0f} m {where} the recorded path of {curve.length_m:.0f} m, which is straight there",
                node.place,
            )

    def say_height(self, x_m: float, y_m: float) -> None:
        """Say where a position without z lies above or below the recorded paths near it."""
        for entity in self.entities.values():
            curve = entity.recorded_curve
            if curve is None or ("", "z") in self._reached:
                continue
            s, left = curve.project(x_m, y_m)
            height = curve.at(s)[2]
            if abs(left) < NEAR_M and -NEAR_M < s < curve.length_m + NEAR_M and abs(height) > OFF_GROUND_M:
                self._reached.add(("", "z"))
                self.document.say(
                    f"a WorldPosition without z has z = 0, where the recorded path of {short(entity.name)} is at {height:.3g} m"
                )

    def say_width(self, node: XmlNode) -> None:
        """Say how wide lanes are taken to be."""
        if self._lanes is None:
            self.document.say(f"LaneChangeAction: no road network is read: lanes are {LANE_WIDTH_M:g} m wide")

    def say_counting(self, lanes: float, sign: int, node: XmlNode) -> None:
        """Say which way relative lanes count beside who drives against its road."""
        if lanes and sign < 0:
            self.document.say(
                f"{node.tag} of who drives against its road: lanes count as their numbers do, which grow to its right",
                node.place,
            )

    def say_turned(self, other: Entity, node: XmlNode) -> None:
        """Say what a relative heading beside who drives against the traffic of its lane counts from."""
        self.document.say(
            f"{node.tag}: {short(other.name)} drives against its lane's traffic: the relative heading counts from that traffic",
            node.place,
        )

    def place(self, entity: Entity, time_s: float, tag: str) -> Place:
        """Return where an entity is. Raises `NotUnderstoodError` where nobody knows."""
        if entity.name in self._awaited:
            raise NotPlacedYetError
        found = entity.place(time_s)
        if found is None:
            raise NotUnderstoodError(f"{tag} (the place of {short(entity.name)} is not known)")
        return found

    def path(self, entity: Entity, time_s: float, tag: str) -> tuple[Curve, float, float, float, int]:
        """Return an entity's path, its arc length, how far left of the path it and its lane's middle are, and 1 where the path
        runs along its road, else -1. Raises `NotUnderstoodError` where nobody knows."""
        if entity.name in self._awaited:
            raise NotPlacedYetError
        found = entity.on_path(time_s)
        if found is None:
            raise NotUnderstoodError(f"{tag} (the place of {short(entity.name)} is not known)")
        curve, s, left = found
        on_own = entity.curve is curve and entity.timed is None
        return curve, s, left, entity.lane_left_m if on_own else left, entity.road_sign if on_own else 1

    def lane_on(self, entity: Entity, lane: int) -> float:
        """Return how far left of an entity's path the middle of a lane of its road lies. Raises `NotUnderstoodError`."""
        lanes = self._lanes
        if lanes is None or entity.curve not in (lanes.curve, lanes.curve.reversed()):
            raise NotUnderstoodError(f"LaneChangeAction to lane {lane} of a road that no recorded path stands for")
        _, left = lanes.on(lanes.s_m, lane_left(lane))
        return left if entity.curve is lanes.curve else -left

    def lane_beside(self, entity: Entity, other: Entity, lanes: float, time_s: float) -> float:
        """Return how far left of an entity's path the middle of a lane lies that is so many lanes left of another one's, as that
        one looks. Raises `NotUnderstoodError`."""
        curve, s, _, lane, _ = self.path(other, time_s, "LaneChangeAction")
        assert entity.curve is not None  # it is steered
        if curve is not entity.curve:
            s, lane = entity.curve.project(*curve.at(s, lane)[:2])
        looks = self.place(other, time_s, "LaneChangeAction")[3] - entity.curve.at(s)[3]
        return lane + math.copysign(lanes, lanes * math.cos(looks)) * LANE_WIDTH_M

    def offset_of(self, entity: Entity, time_s: float) -> float:
        """Return how far an entity is from its lane's middle, to the left of its road's direction."""
        on_path = entity.curve is not None and entity.timed is None
        return entity.road_sign * (entity.left_m - entity.lane_left_m) if on_path else 0.0

    def gap(
        self, entity: Entity, other: Entity | Place, kind: str, free: bool, system: str, time_s: float
    ) -> float | None:
        """Return the distance from an entity to another one, or to a place: along or across it, positive ahead and to the left,
        or the shortest one. ``free``: between their boxes. ``system``: along its box ("entity"), along the line that its path
        has there ("ahead"), or along its path. None where one is not there."""
        own = entity.place(time_s)
        there = other.place(time_s) if isinstance(other, Entity) else other
        if own is None or there is None or (isinstance(other, Entity) and not other.is_there):
            return None
        box = _outline(entity, own)
        outline = _outline(other, there) if isinstance(other, Entity) else np.array([there[:2]] * 4)
        if kind not in ("longitudinal", "lateral"):
            if not free:
                return math.dist(own[:2], there[:2])
            if isinstance(other, Entity):
                return boxes_apart(box, outline)
            return boxes_apart(box, outline + np.array([[0, 0], [1e-6, 0], [1e-6, 1e-6], [0, 1e-6]]))
        axis, ahead = own[3], None
        if system != "entity":
            found = entity.on_path(time_s)
            if found is not None:
                curve, s, left = found
                s_other, left_other = curve.project(there[0], there[1])
                axis = curve.at(s)[3]
                if system != "ahead":
                    ahead = np.array([s_other - s, left_other - left])
        cos, sin = math.cos(axis), math.sin(axis)
        turn = np.array([[cos, -sin], [sin, cos]])
        if ahead is None:
            ahead = (np.array(there[:2]) - np.array(own[:2])) @ turn
        way = 0 if kind == "longitudinal" else 1
        gap = float(ahead[way])
        if not free:
            return gap
        mine = ((box - np.array(own[:2])) @ turn)[:, way]
        # the other box is turned as it is to this one, beside its own reference point
        its = ((outline - np.array(there[:2])) @ turn)[:, way] + gap
        if its.min() > mine.max():
            return float(its.min() - mine.max())
        return float(its.max() - mine.min()) if its.max() < mine.min() else 0.0

    # time

    def wake(self, time_s: float) -> None:
        """Have the storyboard be looked at at a time."""
        if self.now_s < time_s < self.span_s[1]:
            at = bisect.bisect_left(self._ticks, time_s)
            if self._ticks[at] - time_s > 1e-9 and time_s - self._ticks[at - 1] > 1e-9:
                self._ticks.insert(at, time_s)

    def is_in_state(self, kind: str, name: str, state: str) -> bool:
        """Whether a part of the storyboard is in a state, or came to it at this time or the last."""
        wanted = [one for one in name.split("::") if one]
        for element in self._elements:
            if element.kind != kind or element.path()[-len(wanted) :] != wanted:
                continue
            if state == "startTransition" and element.began >= self._tick - 1:
                return True
            if state == "endTransition" and element.ended >= self._tick - 1 and not element.was_stopped:
                return True
            if state == "stopTransition" and element.ended >= self._tick - 1 and element.was_stopped:
                return True
            if state.removesuffix("State") == element.state:
                return True
        return False

    def run(self) -> dict[str, list[Track]]:
        """Return the tracks of all entities until the end, by their names."""
        first, last = self.span_s
        self._start(first)
        self._settle(first)
        moves = any(
            one.curve is not None and one.timed is None and (one.speed_m_s != 0 or one.longitudinal or one.lateral)
            for one in self.entities.values()
        )
        if self.needs_steps or moves:
            count = max(int(math.ceil((last - first) / STEP_S)), 1)
            for time in np.linspace(first, last, count + 1)[1:-1].tolist():
                self.wake(time)
        number = 1
        while number < len(self._ticks):
            before, self.now_s = self._ticks[number - 1], self._ticks[number]
            active = [one for one in self.entities.values() if one.is_there]
            for entity in active:
                entity.plan(self.now_s)
            for entity in active:
                entity.advance(before, self.now_s, self.needs_steps)
            for entity in active:
                entity.settle(self.now_s)
            self._tick += 1
            self._settle(self.now_s)
            number += 1
        for entity in self.entities.values():
            entity.finish(last)
        return {name: entity.tracks for name, entity in self.entities.items()}

    def _start(self, time_s: float) -> None:
        """Do what Init says: places first, those beside others after theirs."""
        waiting = [one for one in self._init if one[3]]
        while waiting:
            left = []
            for one in waiting:
                place, entity, act, _ = one
                self._awaited = {other[1].name for other in waiting if other[1] is not None and other[1] is not entity}
                try:
                    act(time_s)
                except NotPlacedYetError:
                    left.append(one)
                except NotUnderstoodError as fault:
                    self.document.say(f"{fault} is not understood", place)
                    self._homeless += [] if entity is None else [entity]
            if len(left) == len(waiting):
                for place, entity, _, _ in left:
                    self.document.say(
                        "a position beside an entity whose own is beside this one is not understood", place
                    )
                    self._homeless += [] if entity is None else [entity]
                break
            waiting = left
        self._awaited = set()
        for place, entity, act, puts in self._init:
            if not puts:
                was_recorded = entity is not None and entity.is_recorded
                try:
                    act(time_s)
                except NotUnderstoodError as fault:
                    self.document.say(f"{fault} is not understood", place)
                    if entity is not None and was_recorded:
                        self._homeless.append(entity)
        for entity in self._homeless:
            if entity.recorded is not None:
                self.document.say(
                    f"entity {short(entity.name)}: its place at the start is not known: it starts where it was recorded"
                )

    def _settle(self, time_s: float) -> None:
        """Start and end what starts and ends at a time."""
        for _ in range(MOST_PASSES):
            if not any([self._look(act, time_s) for act in self._acts]):
                break
        if self.stops_s is None and self._stop.met(self, time_s):
            self.stops_s = time_s

    def _look(self, act: Act, time_s: float) -> bool:
        changed = False
        if act.state == "standby" and act.start.met(self, time_s):
            changed = True
            act.state, act.began = "running", self._tick
            for group in act.children:
                group.state, group.began = "running", self._tick
                for maneuver in group.children:
                    maneuver.state, maneuver.began = "running", self._tick
        if act.state != "running":
            return changed
        for event in act.events:
            if event.state == "running":
                changed |= self._go_on(event, time_s)
            # what has begun at this time and is over already waits for another edge
            if event.state == "standby" and event.began != self._tick and event.trigger.met(self, time_s):
                self._begin(event, act, time_s)
                changed = True
        if act.stop.met(self, time_s):
            for event in act.events:
                self._end(event, time_s, True)
            self._complete(act, True)
            return True
        return changed | self._complete_what_is_done(act)

    def _begin(self, event: Event, act: Act, time_s: float) -> None:
        others = [
            one for one in act.events if one is not event and one.parent is event.parent and one.state == "running"
        ]
        if event.priority == "skip" and others:
            event.count += 1
            event.state = "complete" if event.count >= event.most else "standby"
            return
        if event.priority in ("override", "overwrite"):
            for one in others:
                self._end(one, time_s, True)
        event.state, event.began, event.count, event.running = "running", self._tick, event.count + 1, []
        for action in event.children:
            action.state, action.began = "running", self._tick
        for action, place, start in event.starts:
            try:
                event.running += [(action, one) for one in start(time_s)]
            except NotUnderstoodError as fault:
                self.document.say(f"{fault} is not understood", place)
        self._go_on(event, time_s)

    def _go_on(self, event: Event, time_s: float) -> bool:
        event.running = [(action, one) for action, one in event.running if not one.done(time_s)]
        going = {id(action) for action, _ in event.running}
        changed = False
        for action in event.children:
            if action.state == "running" and id(action) not in going:
                action.state, action.ended, changed = "complete", self._tick, True
        if not event.running:
            event.state, event.ended = ("complete" if event.count >= event.most else "standby"), self._tick
            return True
        return changed

    def _end(self, event: Event, time_s: float, stopped: bool) -> None:
        for _, one in event.running:
            one.stop(time_s)
        if event.state != "complete":
            for part in (event, *event.children):
                if part.state == "running":
                    part.was_stopped, part.ended = stopped, self._tick
                part.state = "complete"
        event.running = []

    def _complete(self, element: Element, stopped: bool) -> None:
        for one in element.children:
            self._complete(one, stopped)
        if element.state != "complete":
            element.state, element.ended, element.was_stopped = "complete", self._tick, stopped

    def _complete_what_is_done(self, element: Element) -> bool:
        """Complete what all parts of are complete."""
        changed = False
        for one in element.children:
            if one.kind in ("maneuverGroup", "maneuver"):
                changed |= self._complete_what_is_done(one)
        if element.state == "running" and all(one.state == "complete" for one in element.children):
            element.state, element.ended = "complete", self._tick
            if element.kind == "act" and element.parent is not None:
                story = element.parent
                if all(one.state == "complete" for one in story.children):
                    story.state, story.ended = "complete", self._tick
            return True
        return changed


def _name(node: XmlNode) -> str:
    """Return an element's name; where it is an expression that is not understood, as it is written."""
    written = node.element.get("name", node.tag)
    try:
        return node.text("name", node.tag)
    except (NotUnderstoodError, ScenarioError):
        return written


def _as_text(root: XmlNode, name: str) -> str:
    try:
        return text_of(root.scope.find(name))
    except ExpressionError as fault:
        raise NotUnderstoodError(f"the parameter {short(name)} ({fault})") from None


def _outline(entity: Entity, place: Place) -> FloatArray:
    """Return the corners (4, 2) of an entity's box in the plane."""
    x, y, _, h, _, _ = place
    length, width, _ = entity.size_m
    cos, sin = math.cos(h), math.sin(h)
    turn = np.array([[cos, sin], [-sin, cos]])
    cx, cy, _ = entity.centre
    corners = np.array([[length, width], [-length, width], [-length, -width], [length, -width]]) / 2 + np.array(
        [cx, cy]
    )
    return np.array([x, y]) + corners @ turn
