"""The storyboard of an OpenSCENARIO file, worked out in time: which events start when, and where each entity is until the end."""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable

import numpy as np

from ...errors import ScenarioError, short
from ...geometry import Trajectory
from .actions import Actions
from .conditions import Conditions
from .document import Document, NotUnderstoodError, XmlNode
from .entities import STEP_S, Entity, EntityTrack
from .expressions import ExpressionError, text_of
from .paths import LANE_WIDTH_M, Curve, Place
from .roads import Roads
from .story import Act, Element, Event, InitAction, StoryReader

MOST_PASSES = 50
"""At one time, events that start others are worked out so often."""
MOST_ENTITIES = 10_000
Size = tuple[float, float, float]
Described = Callable[[str, Size | None, float | None], tuple[Size, Size, Trajectory | None]]
"""Gives by an entity's name the middle of its box from its reference point, which is given with the box's height where the file
says them, the log's size of the box, and the recorded trajectory of the point."""


class NotPlacedYetError(Exception):
    """A place beside an entity that has none yet."""


class Storyboard:
    """The storyboard of a document between two times. Raises `ScenarioError` for what is not valid."""

    def __init__(self, document: Document, span_s: tuple[float, float], ego: str | None, describe: Described) -> None:
        self.document, self.span_s, self.now_s, self.ego = document, span_s, span_s[0], ego
        self.needs_steps = False
        self.entities: dict[str, Entity] = {}
        self._ticks = [span_s[0], span_s[1]]
        self._tick = 0
        self._awaited: set[str] = set()
        root = document.node.declaring()
        self.parameters = {name: str(root.scope.own[name]) for name in root.scope.own}
        for name in self.parameters:
            try:
                self.parameters[name] = _as_text(root, name)
            except NotUnderstoodError as fault:
                document.say(f"{fault} is not understood")
        self.variables = {
            variable.text("name"): variable.text("value")
            for holder in root.children("VariableDeclarations")
            for variable in holder.children("VariableDeclaration")
        }
        self.actions = Actions(document, self)
        self.conditions = Conditions(document, self, self.actions.positions)
        self._read_entities(root, describe)
        self.roads = Roads(document, root.child("RoadNetwork"))
        board = root.child("Storyboard")
        if board is None:
            other = next((tag for tag in ("ParameterValueDistribution", "Catalog") if root.child(tag)), None)
            instead = "" if other is None else f": it is a {other}, which goes with a scenario"
            raise ScenarioError(f"{document.path}: has no Storyboard{instead}")
        reader = StoryReader(self)
        self._init, self._homeless = reader.init(board), reader.homeless
        on_roads = [
            start for start in self.actions.positions.on_roads if self.entities[start.entity].recorded is not None
        ]
        if on_roads:
            start = min(on_roads, key=lambda start: start.entity != ego)
            self.roads.anchor(start, self.entities[start.entity], span_s[0])
        self._stories = [reader.story(story) for story in board.children("Story")]
        self._stop = self.conditions.trigger(board.child("StopTrigger"), "Storyboard: StopTrigger", False)
        self.stops_s: float | None = None
        every = board.element.iter("EntityAction")
        added = {action.get("entityRef", "") for action in every if action.find("AddEntityAction") is not None}
        starts = board.element.findall("Init/Actions/Private")
        placed = {
            private.get("entityRef", "")
            for private in starts
            if private.find("PrivateAction/TeleportAction") is not None
        }
        for name, entity in self.entities.items():
            given = {name, *(f"${key}" for key, value in self.parameters.items() if value == name)}
            if given & added and not given & placed and name != ego:
                entity.is_there = False

    # what is read

    def _read_entities(self, root: XmlNode, describe: Described) -> None:
        holder = root.child("Entities")
        for node in [] if holder is None else holder.children("ScenarioObject"):
            name = node.text("name")
            if name in self.entities:
                raise ScenarioError(f"{self.document.path}: Entities: two are named {short(name)}")
            if len(self.entities) == MOST_ENTITIES:
                raise ScenarioError(f"{self.document.path}: Entities: more than {MOST_ENTITIES}")
            kind = next((child for tag in ("Vehicle", "Pedestrian", "MiscObject") if (child := node.child(tag))), None)
            reference = node.child("CatalogReference")
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
        for node in [] if holder is None else holder.children("EntitySelection"):
            self.document.say(f"entities: the selection {short(node.element.get('name', ''))} is not understood")
            node.settled()

    def entity(self, name: str) -> Entity:
        """Return an entity by its name. Raises `ScenarioError`."""
        if name not in self.entities:
            raise ScenarioError(f"{self.document.path}: entityRef: there is no entity {short(name)}")
        return self.entities[name]

    def entities_of(self, holder: XmlNode) -> list[Entity]:
        """Return the entities that the EntityRefs of an element name. Raises `ScenarioError`."""
        return [self.entity(reference.text("entityRef")) for reference in holder.children("EntityRef")]

    def place(self, entity: Entity, time_s: float, tag: str) -> Place:
        """Return where an entity is. Raises `NotUnderstoodError` where nobody knows."""
        if entity.name in self._awaited:
            raise NotPlacedYetError
        place = entity.place(time_s)
        if place is None:
            raise NotUnderstoodError(f"{tag} (the place of {short(entity.name)} is not known)")
        return place

    def path(self, entity: Entity, time_s: float, tag: str) -> tuple[Curve, float, float, float, int]:
        """Return an entity's path, its arc length, how far left of the path it and its lane's middle are, and 1 where the path
        runs along its road, else -1. Raises `NotUnderstoodError` where nobody knows."""
        if entity.name in self._awaited:
            raise NotPlacedYetError
        path = entity.on_path(time_s)
        if path is None:
            raise NotUnderstoodError(f"{tag} (the place of {short(entity.name)} is not known)")
        curve, s, left = path
        on_own = entity.curve is curve and entity.timed is None
        return curve, s, left, entity.lane_left_m if on_own else left, entity.road_sign if on_own else 1

    def lane_beside(self, entity: Entity, other: Entity, lanes: float, time_s: float) -> float:
        """Return how far left of an entity's path the middle of a lane lies that is so many lanes left of another one's, as that
        one looks. Raises `NotUnderstoodError`."""
        curve, s, _, lane, _ = self.path(other, time_s, "LaneChangeAction")
        assert entity.curve is not None  # it is steered
        if curve is not entity.curve:
            s, lane = entity.curve.project(*curve.at(s, lane)[:2])
        looks = self.place(other, time_s, "LaneChangeAction")[3] - entity.curve.at(s)[3]
        return lane + math.copysign(lanes, lanes * math.cos(looks)) * LANE_WIDTH_M

    # time

    def wake(self, time_s: float) -> None:
        """Have the storyboard be looked at at a time."""
        if self.now_s < time_s < self.span_s[1]:
            at = bisect.bisect_left(self._ticks, time_s)
            if self._ticks[at] - time_s > 1e-9 and time_s - self._ticks[at - 1] > 1e-9:
                self._ticks.insert(at, time_s)

    def is_in_state(self, kind: str, name: str, state: str) -> bool:
        """Whether a part of the storyboard is in a state, or came to it at this time or the last."""
        wanted = [part_name for part_name in name.split("::") if part_name]
        for element in (part for story in self._stories for part in story.parts()):
            if element.kind != kind or element.path()[-len(wanted) :] != wanted:
                continue
            has_ended = element.ended >= self._tick - 1
            states = {
                f"{element.state}State": True,
                "startTransition": element.began >= self._tick - 1,
                "endTransition": has_ended and not element.was_stopped,
                "stopTransition": has_ended and element.was_stopped,
            }
            if states.get(state):
                return True
        return False

    def run(self) -> dict[str, list[EntityTrack]]:
        """Return the tracks of all entities until the end, by their names."""
        first, last = self.span_s
        self._start(first)
        self._settle(first)
        moves = any(
            entity.curve is not None
            and entity.timed is None
            and (entity.speed_m_s != 0 or entity.longitudinal or entity.lateral)
            for entity in self.entities.values()
        )
        if self.needs_steps or moves:
            count = max(int(math.ceil((last - first) / STEP_S)), 1)
            for time in np.linspace(first, last, count + 1)[1:-1].tolist():
                self.wake(time)
        number = 1
        while number < len(self._ticks):
            before, self.now_s = self._ticks[number - 1], self._ticks[number]
            active = [entity for entity in self.entities.values() if entity.is_there]
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
        waiting = [action for action in self._init if action.puts]
        while waiting:
            left = []
            for action in waiting:
                others = (other.entity for other in waiting if other.entity is not action.entity)
                self._awaited = {other.name for other in others if other is not None}
                try:
                    action.run(time_s)
                except NotPlacedYetError:
                    left.append(action)
                except NotUnderstoodError as fault:
                    self._not_placed(action, f"{fault} is not understood")
            if len(left) == len(waiting):
                for action in left:
                    self._not_placed(
                        action, "a position beside an entity whose own is beside this one is not understood"
                    )
                break
            waiting = left
        self._awaited = set()
        for action in self._init:
            if not action.puts:
                was_recorded = action.entity is not None and action.entity.is_recorded
                try:
                    action.run(time_s)
                except NotUnderstoodError as fault:
                    self.document.say(f"{fault} is not understood", action.place)
                    if action.entity is not None and was_recorded:
                        self._homeless.append(action.entity)
        for entity in self._homeless:
            if entity.recorded is not None:
                self.document.say(
                    f"entity {short(entity.name)}: its place at the start is not known: it starts where it was recorded"
                )

    def _not_placed(self, action: InitAction, why: str) -> None:
        self.document.say(why, action.place)
        self._homeless += [] if action.entity is None else [action.entity]

    def _settle(self, time_s: float) -> None:
        """Start and end what starts and ends at a time."""
        for _ in range(MOST_PASSES):
            if not any(
                [self._look(act, time_s) for story in self._stories for act in story.children if isinstance(act, Act)]
            ):
                break
        if self.stops_s is None and self._stop.met(self, time_s):
            self.stops_s = time_s

    def _look(self, act: Act, time_s: float) -> bool:
        changed = False
        if act.state == "standby" and act.start.met(self, time_s):
            changed = True
            groups = act.children
            for element in (act, *groups, *(maneuver for group in groups for maneuver in group.children)):
                element.begin(self._tick)
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
                self._stop_event(event, time_s)
            self._stop_all(act)
            return True
        return changed | self._complete_what_is_done(act)

    def _begin(self, event: Event, act: Act, time_s: float) -> None:
        others = [
            other
            for other in act.events
            if other is not event and other.parent is event.parent and other.state == "running"
        ]
        if event.priority == "skip" and others:
            event.count += 1
            event.state = "complete" if event.count >= event.most else "standby"
            return
        if event.priority in ("override", "overwrite"):
            for other in others:
                self._stop_event(other, time_s)
        event.count, event.running = event.count + 1, []
        for element in (event, *event.children):
            element.begin(self._tick)
        for action, place, start in event.starts:
            try:
                event.running += [(action, running) for running in start(time_s)]
            except NotUnderstoodError as fault:
                self.document.say(f"{fault} is not understood", place)
        self._go_on(event, time_s)

    def _go_on(self, event: Event, time_s: float) -> bool:
        event.running = [(action, running) for action, running in event.running if not running.done(time_s)]
        going = {id(action) for action, _ in event.running}
        changed = False
        for action in event.children:
            if action.state == "running" and id(action) not in going:
                action.end(self._tick)
                changed = True
        if not event.running:
            event.state, event.ended = ("complete" if event.count >= event.most else "standby"), self._tick
            return True
        return changed

    def _stop_event(self, event: Event, time_s: float) -> None:
        for _, running in event.running:
            running.stop(time_s)
        if event.state != "complete":
            for part in (event, *event.children):
                if part.state == "running":
                    part.end(self._tick, True)
                part.state = "complete"
        event.running = []

    def _stop_all(self, element: Element) -> None:
        for part in element.children:
            self._stop_all(part)
        if element.state != "complete":
            element.end(self._tick, True)

    def _complete_what_is_done(self, element: Element) -> bool:
        """Complete what all parts of are complete."""
        changed = False
        for child in element.children:
            if child.kind in ("maneuverGroup", "maneuver"):
                changed |= self._complete_what_is_done(child)
        if element.state == "running" and all(child.state == "complete" for child in element.children):
            element.end(self._tick)
            story = element.parent if element.kind == "act" else None
            if story is not None and all(act.state == "complete" for act in story.children):
                story.end(self._tick)
            return True
        return changed


def _as_text(root: XmlNode, name: str) -> str:
    try:
        return text_of(root.scope.find(name))
    except ExpressionError as fault:
        raise NotUnderstoodError(f"the parameter {short(name)} ({fault})") from None
