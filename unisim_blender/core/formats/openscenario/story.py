"""The parts of an OpenSCENARIO storyboard, stories down to actions, as they are read and as they start and end."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING

from ...errors import ScenarioError
from .conditions import Trigger
from .document import NotUnderstoodError, ReadT, XmlNode
from .entities import Entity
from .motions import Running

if TYPE_CHECKING:
    from .storyboard import Storyboard


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

    def __post_init__(self) -> None:
        if self.parent is not None:
            self.parent.children.append(self)

    def parts(self) -> Iterator[Element]:
        """Yield it and all that it holds."""
        yield self
        for child in self.children:
            yield from child.parts()

    def path(self) -> list[str]:
        """Return its names from the story down."""
        return [*([] if self.parent is None else self.parent.path()), self.name]

    def begin(self, tick: int) -> None:
        """Have it run from a tick on."""
        self.state, self.began = "running", tick

    def end(self, tick: int, stopped: bool = False) -> None:
        self.state, self.ended, self.was_stopped = "complete", tick, stopped


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


@dataclass(frozen=True)
class InitAction:
    """An action of Init: its place in the file, its entity, what it does, and whether it puts the entity somewhere."""

    place: str
    entity: Entity | None
    run: Callable[[float], object]
    puts: bool


class StoryReader:
    """Reads Init and the stories of a storyboard. What is not understood is said."""

    def __init__(self, board: Storyboard) -> None:
        self.board, self.document = board, board.document
        self.homeless: list[Entity] = []
        """Entities whose place at the start is not understood."""

    def init(self, board: XmlNode) -> list[InitAction]:
        init_actions: list[InitAction | None] = []
        actions = board.child("Init", "Actions")
        for private in [] if actions is None else actions.children():
            if private.tag != "Private":
                init_actions.append(self._try(private.at("Init"), self._of_everybody))
                continue
            name = private.text("entityRef")
            entity = self.board.entity(name)
            self.board.actions.positions.owner = name
            for node in private.at(f"Init: {name}").children():
                init_actions.append(self._try(node, partial(self._of_entity, entity=entity)))
                places = node.child("TeleportAction") or node.child("RoutingAction")
                if init_actions[-1] is None and places is not None:
                    self.homeless.append(entity)
            self.board.actions.positions.owner = None
        return [action for action in init_actions if action is not None]

    def _of_everybody(self, node: XmlNode) -> InitAction:
        return InitAction(node.place, None, self.board.actions.everybody(node), False)

    def _of_entity(self, node: XmlNode, entity: Entity) -> InitAction:
        start, puts = self.board.actions.private(node), node.child("TeleportAction") is not None
        return InitAction(node.place, entity, lambda time_s: start(entity, time_s), puts)

    def _try(self, node: XmlNode, read: Callable[[XmlNode], ReadT]) -> ReadT | None:
        """Return what a reader gives of an element; None where it is not understood, which is said."""
        try:
            return read(node)
        except NotUnderstoodError as fault:
            self.document.say(f"{fault} is not understood", node.place)
            node.settled()
            return None

    def story(self, story: XmlNode) -> Element:
        """Return a story, which runs from the start."""
        story = story.declaring()
        whole = Element("story", _name(story), state="running", began=0)
        trigger = self.board.conditions.trigger
        for node in story.children("Act"):
            node = node.declaring()
            place = f"{_name(story)}/{_name(node)}"
            start = trigger(node.child("StartTrigger"), f"{place}: StartTrigger", True)
            stop = trigger(node.child("StopTrigger"), f"{place}: StopTrigger", False)
            act = Act("act", _name(node), whole, start=start, stop=stop)
            for group in node.children("ManeuverGroup"):
                self._group(group, act, place)
        return whole

    def _group(self, node: XmlNode, act: Act, place: str) -> None:
        group = Element("maneuverGroup", _name(node), act)
        if node.has("maximumExecutionCount") and node.number("maximumExecutionCount") != 1:
            self.document.say("ManeuverGroup: maximumExecutionCount is taken as 1", place)
        holder, entities = node.child("Actors"), []
        if holder is not None:
            if holder.truth("selectTriggeringEntities", "false"):
                self.document.say("Actors: selectTriggeringEntities is not understood: those that are named act", place)
            entities = self.board.entities_of(holder)
        maneuvers = [maneuver.declaring() for maneuver in node.children("Maneuver")]
        for reference in node.children("CatalogReference"):
            entry = self._try(reference.at(f"{place}/{_name(node)}"), self.document.catalog_entry)
            maneuvers += [] if entry is None else [entry]
        for of_group in maneuvers:
            maneuver = Element("maneuver", _name(of_group), group)
            for event in of_group.children("Event"):
                act.events.append(self._event(event, maneuver, entities, place))

    def _event(self, node: XmlNode, maneuver: Element, entities: list[Entity], place: str) -> Event:
        here = f"{place}/{_name(node)}"
        trigger = self.board.conditions.trigger(node.child("StartTrigger"), f"{here}: StartTrigger", True)
        priority = node.text("priority", "parallel")
        most = int(node.number("maximumExecutionCount", "1"))
        event = Event("event", _name(node), maneuver, trigger=trigger, priority=priority, most=max(most, 1))
        for of_event in node.children("Action"):
            action = Element("action", _name(of_event), event)
            for kind in of_event.at(f"{here}/{_name(of_event)}").children():
                self._try(kind, partial(self._action, event=event, action=action, entities=entities))
        return event

    def _action(self, node: XmlNode, event: Event, action: Element, entities: list[Entity]) -> None:
        if node.tag != "PrivateAction":
            act = self.board.actions.everybody(node)

            def run(time_s: float) -> list[Running]:
                act(time_s)
                return []

            event.starts.append((action, node.place, run))
            return
        start = self.board.actions.private(node)
        timed = node.child("RoutingAction", "FollowTrajectoryAction", "TimeReference", "Timing")
        # all other motions are worked out step by step
        self.board.needs_steps |= timed is None and node.child("TeleportAction") is None

        def run_own(time_s: float) -> list[Running]:
            return [start(entity, time_s) for entity in entities if entity.is_there]

        event.starts.append((action, node.place, run_own))


def _name(node: XmlNode) -> str:
    """Return an element's name; where it is an expression that is not understood, as it is written."""
    written = node.element.get("name", node.tag)
    try:
        return node.text("name", node.tag)
    except (NotUnderstoodError, ScenarioError):
        return written
