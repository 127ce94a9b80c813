"""Conditions of OpenSCENARIO: what each one asks of the entities and of the storyboard at a time.

A reader takes all attributes of a condition at once and returns a function of time: True, False, or False where what it asks for
is not there (no entity, no speed).
"""

from __future__ import annotations

import bisect
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from ...errors import short
from .distances import distance_between
from .document import Document, NotUnderstoodError, XmlNode, innermost, read_child
from .entities import STANDS_M_S, Entity
from .paths import Place
from .positions import Positions

if TYPE_CHECKING:
    from .storyboard import Storyboard

CLOSE = 1e-6
"""Numbers that differ by less are equal."""
RULES = ("greaterThan", "greaterOrEqual", "lessThan", "lessOrEqual", "equalTo", "notEqualTo")
EDGES = ("none", "rising", "falling", "risingOrFalling")
SYSTEMS = ("entity", "lane", "road", "trajectory")
STATES = (
    "startTransition", "endTransition", "stopTransition", "skipTransition", "completeState", "runningState",
    "standbyState",
)  # fmt: skip
KINDS = ("longitudinal", "lateral", "euclidianDistance", "cartesianDistance")
Ask = Callable[[float], bool]
AskOf = Callable[[Entity, float], bool]


def fits(value: float | None, rule: str, limit: float) -> bool:
    """Whether a number is as a rule says; None is as no rule says."""
    if value is None or math.isnan(value):
        return False
    if rule == "equalTo":
        return abs(value - limit) <= CLOSE
    if rule == "notEqualTo":
        return abs(value - limit) > CLOSE
    if rule in ("greaterThan", "greaterOrEqual"):
        return value > limit + (CLOSE if rule == "greaterThan" else -CLOSE)
    return value < limit - (CLOSE if rule == "lessThan" else -CLOSE)


@dataclass(eq=False)
class Condition:
    """A condition with its edge and its delay. ``from_before``: whether it was asked before the start, and was not met then."""

    ask: Ask
    edge: str
    delay_s: float
    from_before: bool
    last: bool | None = None
    _tick_s: float = -math.inf
    _was: bool | None = None
    _looked_s: float = -math.inf
    _met_s: list[float] = field(default_factory=list)

    def met(self, board: Storyboard, time_s: float) -> bool:
        """Whether it is met now. It may be asked more than once at a time."""
        if time_s > self._tick_s:
            self._looked_s, self._tick_s = self._tick_s, time_s
            self._was = self.last if self.last is not None else (False if self.from_before else None)
        self.last = self.ask(time_s)
        was = self._was
        rises, falls = was is False and self.last, was is True and not self.last
        met = {"none": self.last, "rising": rises, "falling": falls, "risingOrFalling": rises or falls}[self.edge]
        if self.delay_s <= 0:
            return met
        if met and (not self._met_s or self._met_s[-1] < time_s):
            self._met_s.append(time_s)
            board.wake(time_s + self.delay_s)
        after = bisect.bisect_right(self._met_s, self._looked_s - self.delay_s + 1e-9)
        upto = bisect.bisect_right(self._met_s, time_s - self.delay_s + 1e-9)
        return upto > after


@dataclass(eq=False)
class Trigger:
    """Groups of conditions: met where all of one group are. Without a group it is ``met_when_empty``."""

    groups: list[list[Condition]]
    met_when_empty: bool

    def met(self, board: Storyboard, time_s: float) -> bool:
        if not self.groups:
            return self.met_when_empty
        # all are asked each time, as an edge is seen only by who looked before
        return any([all([condition.met(board, time_s) for condition in group]) for group in self.groups])


class Conditions:
    """Reads triggers and conditions of a file."""

    def __init__(self, document: Document, board: Storyboard, positions: Positions) -> None:
        self.document, self.board, self.positions = document, board, positions

    def trigger(self, node: XmlNode | None, place: str, met_when_empty: bool) -> Trigger:
        """Read a trigger. A group with a condition that is not understood is never met, and a sentence says so."""
        groups = []
        for group in [] if node is None else node.children("ConditionGroup"):
            conditions, complete = [], True
            for condition in group.at(place).children("Condition"):
                try:
                    conditions.append(self._condition(condition))
                except NotUnderstoodError as fault:
                    self.document.say(f"{fault} is not understood: its group of conditions is never met", place)
                    condition.settled()
                    complete = False
            if complete:
                groups.append(conditions)
            elif not groups:
                groups.append([NEVER])
        return Trigger(groups, met_when_empty)

    def _condition(self, node: XmlNode) -> Condition:
        edge = node.choice("conditionEdge", EDGES, "none")
        delay = node.number("delay", "0")
        by_entity, by_value = node.child("ByEntityCondition"), node.child("ByValueCondition")
        if by_entity is not None:
            return Condition(self._by_entity(by_entity), edge, delay, False)
        if by_value is None:
            raise NotUnderstoodError(innermost(node.element))
        time = by_value.child("SimulationTimeCondition")
        if time is not None:
            rule, value = time.choice("rule", RULES), time.number("value")
            if value > 0:
                self.board.wake(value)
            self.board.wake(value + delay)
            # what is later than a time by nothing is taken as met at that time
            rule = {"greaterThan": "greaterOrEqual", "lessThan": "lessThan"}.get(rule, rule)
            return Condition(lambda time_s: fits(time_s, rule, value), edge, delay, rule == "greaterOrEqual")
        return Condition(self._by_value(by_value), edge, delay, False)

    def _by_value(self, node: XmlNode) -> Ask:
        state = node.child("StoryboardElementStateCondition")
        if state is not None:
            self.board.needs_steps = True
            kind, name = state.text("storyboardElementType"), state.text("storyboardElementRef")
            wanted = state.choice("state", STATES)
            return lambda time_s: self.board.is_in_state(kind, name, wanted)
        for tag, values in (("Parameter", self.board.parameters), ("Variable", self.board.variables)):
            condition = node.child(f"{tag}Condition")
            if condition is not None:
                self.board.needs_steps = True
                name = condition.name_in(f"{tag.lower()}Ref")
                rule, value = condition.choice("rule", RULES), condition.text("value")
                if name not in values:
                    raise NotUnderstoodError(f"{tag}Condition with {short(name)} (which is not declared)")
                return lambda time_s, values=values, name=name: _compares(values[name], rule, value)  # type: ignore[misc]
        raise NotUnderstoodError(innermost(node.element))

    def _by_entity(self, node: XmlNode) -> Ask:
        self.board.needs_steps = True
        holder, asked = node.child("TriggeringEntities"), node.child("EntityCondition")
        if holder is None or asked is None:
            raise NotUnderstoodError(innermost(node.element))
        every = holder.choice("triggeringEntitiesRule", ("any", "all"), "any") == "all"
        entities = self.board.entities_of(holder)
        ask = self._of_entity(asked)

        def met(time_s: float) -> bool:
            # all are asked, as some conditions remember
            answers = [
                entity.is_there and entity.place(time_s) is not None and ask(entity, time_s) for entity in entities
            ]
            return bool(answers) and (all(answers) if every else any(answers))

        return met

    def _of_entity(self, node: XmlNode) -> AskOf:
        readers: dict[tuple[str, ...], Callable[[XmlNode], AskOf]] = {
            ("TimeHeadwayCondition",): self._headway,
            ("TimeToCollisionCondition",): self._time_to_collision,
            ("AccelerationCondition",): self._acceleration,
            ("StandStillCondition",): self._stands,
            ("SpeedCondition",): self._speed,
            ("RelativeSpeedCondition",): self._relative_speed,
            ("TraveledDistanceCondition",): self._traveled,
            ("ReachPositionCondition",): self._reaches,
            ("DistanceCondition",): self._distance,
            ("RelativeDistanceCondition",): self._relative_distance,
            ("CollisionCondition",): self._collides,
        }
        return read_child(node, readers)

    def _measure(self, node: XmlNode, default: str) -> tuple[str, bool, str]:
        """Read what kind of distance is meant: its kind, whether between boxes, and along what."""
        along_route = node.has("alongRoute") and node.truth("alongRoute")
        system = node.choice("coordinateSystem", SYSTEMS, "road" if along_route else "entity")
        kind = node.choice("relativeDistanceType", KINDS, "longitudinal" if along_route else default)
        if node.has("routingAlgorithm"):
            self.document.say(f"{node.tag}: routingAlgorithm is not read: ways are those of recorded paths", node.place)
            node.text("routingAlgorithm")
        return kind, node.truth("freespace", "false"), system

    def _headway(self, node: XmlNode) -> AskOf:
        other, rule, value = self.board.entity(node.text("entityRef")), node.choice("rule", RULES), node.number("value")
        kind, free, system = self._measure(node, "longitudinal")

        def ask(entity: Entity, time_s: float) -> bool:
            gap, speed = distance_between(entity, other, kind, free, system, time_s), entity.speed(time_s)
            # there is no headway to what is behind, and none of what stands or goes backward
            return gap is not None and gap >= 0 and speed > CLOSE and fits(gap / speed, rule, value)

        return ask

    def _time_to_collision(self, node: XmlNode) -> AskOf:
        rule, value = node.choice("rule", RULES), node.number("value")
        kind, free, system = self._measure(node, "euclidianDistance")
        holder = node.child("TimeToCollisionConditionTarget")
        entity, position = (None, None) if holder is None else (holder.child("EntityRef"), holder.child("Position"))
        if entity is None and position is None:
            raise NotUnderstoodError("TimeToCollisionCondition without a target")
        target = self._entity(entity) if entity is not None else self._place(node, position)

        def ask(entity: Entity, time_s: float) -> bool:
            other = target(time_s)
            if other is None:
                return False
            gap = distance_between(entity, other, kind, free, system, time_s)
            closes = _closing(entity, other, kind, time_s)
            return gap is not None and gap >= 0 and closes > CLOSE and fits(gap / closes, rule, value)

        return ask

    def _entity(self, node: XmlNode) -> Callable[[float], Entity]:
        """Read which entity an element's entityRef names, as a function of time."""
        entity = self.board.entity(node.text("entityRef"))
        return lambda time_s: entity

    def _place(self, node: XmlNode, position: XmlNode | None) -> Callable[[float], Place | None]:
        """Read a condition's position as a function of time."""
        if position is None:
            raise NotUnderstoodError(f"{node.tag} without a Position")
        locate = self.positions.position(position)

        def place(time_s: float) -> Place | None:
            try:
                return locate(time_s).place
            except NotUnderstoodError as fault:
                self.document.say(f"{fault} is not understood: its group of conditions is never met", position.place)
                return None

        return place

    def _directed(self, node: XmlNode) -> Callable[[Entity, float], float]:
        """Read a direction: a function that gives the share of a motion along it, or None where it counts as it is."""
        direction = node.text("direction") if node.has("direction") else None
        if direction not in (None, "longitudinal"):
            raise NotUnderstoodError(f"{node.tag} with the direction {short(direction)}")
        return lambda entity, time_s: entity.speed(time_s)

    def _compared(self, node: XmlNode) -> tuple[str, float, bool]:
        """Read a rule, a value, and whether the sign of what is compared counts: the total, without a direction, has none."""
        rule, value, signed = node.choice("rule", RULES), node.number("value"), node.has("direction")
        if value < 0 and not signed:
            self.document.say(
                f"{node.tag} with {value:g} and without a direction: the total is compared, which is never below 0",
                node.place,
            )
        return rule, value, signed

    def _acceleration(self, node: XmlNode) -> AskOf:
        self._directed(node)
        rule, value, signed = self._compared(node)
        return lambda entity, time_s: fits(
            entity.acceleration_m_s2 if signed else abs(entity.acceleration_m_s2), rule, value
        )

    def _stands(self, node: XmlNode) -> AskOf:
        duration = node.number("duration")
        return lambda entity, time_s: entity.still_s >= duration - CLOSE and abs(entity.speed(time_s)) < STANDS_M_S

    def _speed(self, node: XmlNode) -> AskOf:
        speed = self._directed(node)
        rule, value, signed = self._compared(node)
        return lambda entity, time_s: fits(speed(entity, time_s) if signed else abs(speed(entity, time_s)), rule, value)

    def _relative_speed(self, node: XmlNode) -> AskOf:
        speed = self._directed(node)
        other, rule, value = self.board.entity(node.text("entityRef")), node.choice("rule", RULES), node.number("value")
        return lambda entity, time_s: fits(speed(entity, time_s) - speed(other, time_s), rule, value)

    def _traveled(self, node: XmlNode) -> AskOf:
        value = node.number("value")
        return lambda entity, time_s: entity.way_m >= value - CLOSE

    def _reaches(self, node: XmlNode) -> AskOf:
        tolerance, place = node.number("tolerance"), self._place(node, node.child("Position"))

        def ask(entity: Entity, time_s: float) -> bool:
            own, there = entity.place(time_s), place(time_s)
            return own is not None and there is not None and math.dist(own[:2], there[:2]) <= tolerance

        return ask

    def _distance(self, node: XmlNode) -> AskOf:
        return self._is_away(node, self._place(node, node.child("Position")))

    def _relative_distance(self, node: XmlNode) -> AskOf:
        return self._is_away(node, self._entity(node))

    def _is_away(self, node: XmlNode, target: Callable[[float], Entity | Place | None]) -> AskOf:
        rule, value = node.choice("rule", RULES), node.number("value")
        kind, free, system = self._measure(node, "euclidianDistance")

        def ask(entity: Entity, time_s: float) -> bool:
            other = target(time_s)
            gap = None if other is None else distance_between(entity, other, kind, free, system, time_s)
            return gap is not None and fits(abs(gap), rule, value)

        return ask

    def _collides(self, node: XmlNode) -> AskOf:
        given = node.child("EntityRef")
        if given is None:
            raise NotUnderstoodError("CollisionCondition by type")
        other = self.board.entity(given.text("entityRef"))

        def ask(entity: Entity, time_s: float) -> bool:
            gap = distance_between(entity, other, "euclidianDistance", True, "entity", time_s)
            return gap is not None and gap <= 0

        return ask


NEVER = Condition(lambda time_s: False, "none", 0.0, False)


def _closing(entity: Entity, other: Entity | Place, kind: str, time_s: float) -> float:
    """Return how fast two come closer, along the first one's heading or along the line between them."""
    own = entity.place(time_s)
    there = other.place(time_s) if isinstance(other, Entity) else other
    if own is None or there is None:
        return 0.0
    vx, vy = entity.velocity(time_s)
    wx, wy = other.velocity(time_s) if isinstance(other, Entity) else (0.0, 0.0)
    if kind == "longitudinal":
        ux, uy = math.cos(own[3]), math.sin(own[3])
    elif kind == "lateral":
        ux, uy = -math.sin(own[3]), math.cos(own[3])
    else:
        away = max(math.dist(own[:2], there[:2]), 1e-9)
        ux, uy = (there[0] - own[0]) / away, (there[1] - own[1]) / away
    return (vx - wx) * ux + (vy - wy) * uy


def _compares(value: str, rule: str, limit: str) -> bool:
    """Whether a parameter's value is as a rule says: as numbers where both are."""
    try:
        return fits(float(value), rule, float(limit))
    except ValueError:
        return (value == limit) == (rule == "equalTo") and rule in ("equalTo", "notEqualTo")
