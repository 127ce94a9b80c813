"""What OpenSCENARIO's storyboard says of where each entity is: trajectories with times, places, speeds, and when it is there.

An event is understood where simulation time alone starts it. All else is named in a sentence, by its place in the storyboard.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path as FilePath
from xml.etree.ElementTree import Element

import numpy as np

from ...errors import ScenarioError, short
from ...geometry import Trajectory, make_pose
from ...simulation.actors.path import Path
from .reference import pose_at, world_position

Position = dict[str, float]
Centre = tuple[float, float, float]
Recorded = Callable[[str, Centre], Trajectory | None]
"""Gives the recorded trajectory of an entity's reference point, by its name and where its box's middle is from there."""
STEP_S = 0.1
"""Speeds are integrated in steps of this length."""
BESIDE_M = 1.0
"""What starts no further from its recorded path drives along it; all else drives straight on."""


@dataclass(frozen=True, eq=False)
class Track:
    """Where an entity's reference point is: ``positions`` (`world_position`) at ``times_s``.

    One position stands, none is as recorded. ``centre`` is the middle of its box from there. It is there from ``appears_s``
    until ``vanishes_s``.
    """

    times_s: list[float]
    positions: list[Position]
    centre: Centre
    appears_s: float | None
    vanishes_s: float | None


@dataclass
class _Entity:
    """What is said of an entity: ``keys`` of each trajectory, ``speeds`` as time, value, and seconds or m/s² of the change."""

    centre: Centre
    start: Position | None = None
    appears_s: float | None = None
    vanishes_s: float | None = None
    keys: list[tuple[list[float], list[Position]]] = field(default_factory=list)
    speeds: list[tuple[float, float, str, float]] = field(default_factory=list)


class _NotUnderstoodError(Exception):
    """A part of a file that is valid and not understood."""


def tracks_of(
    root: Element, path: FilePath, span_s: tuple[float, float], recorded: Recorded
) -> tuple[dict[str, Track], list[str]]:
    """Return the tracks of a file's entities by their names, and a sentence for each part that is not understood. ``span_s``:
    from when to when the drive is. Raises `ScenarioError` for what is not valid."""
    reader = _Reader(path, _parameters(root))
    board = root.find("Storyboard")
    if board is None:
        raise ScenarioError(f"{path}: has no Storyboard")
    reader.entities(root)
    reader.init(board)
    for story in board.iter("Story"):
        for act in story.iter("Act"):
            reader.act(act, f"{story.get('name', 'Story')}/{act.get('name', 'Act')}")
    tracks = {name: reader.track(name, one, span_s, recorded) for name, one in reader.known.items()}
    return tracks, reader.losses


def _parameters(root: Element) -> dict[str, str]:
    declared = root.findall("ParameterDeclarations/ParameterDeclaration")
    return {one.get("name", ""): one.get("value", "") for one in declared}


class _Reader:
    def __init__(self, path: FilePath, parameters: dict[str, str]) -> None:
        self.path, self.parameters = path, parameters
        self.known: dict[str, _Entity] = {}
        self.losses: list[str] = []

    def text(self, element: Element, name: str, default: str | None = None) -> str:
        """An attribute, with the parameter's value in its place."""
        value = element.get(name, default)
        if value is None:
            raise ScenarioError(f"{self.path}: {element.tag}: has no {name}")
        if value.startswith("${"):
            raise _NotUnderstoodError(f"the expression {short(value)}")
        if value.startswith("$"):
            if value[1:] not in self.parameters:
                raise ScenarioError(f"{self.path}: {element.tag}: {name}: there is no parameter {short(value)}")
            return self.parameters[value[1:]]
        return value

    def number(self, element: Element, name: str, default: str | None = None) -> float:
        """A finite number."""
        value = self.text(element, name, default)
        try:
            found = float(value)
        except ValueError:
            found = math.nan
        if not math.isfinite(found) or abs(found) > 1e9:
            raise ScenarioError(f"{self.path}: {element.tag}: {name} must be a finite number, not {short(value)}")
        return found

    def entities(self, root: Element) -> None:
        """Note the entities."""
        for one in root.findall("Entities/ScenarioObject"):
            name = self.text(one, "name")
            centre = one.find("*/BoundingBox/Center")
            place = (0.0, 0.0, 0.0)
            if centre is None:
                self.losses.append(
                    f"entity {short(name)}: has no bounding box here: its middle is taken as its reference point"
                )
            else:
                place = (self.number(centre, "x"), self.number(centre, "y"), self.number(centre, "z"))
            self.known[name] = _Entity(place)
        for one in root.findall("Entities/EntitySelection"):
            self.losses.append(f"entities: the selection {short(one.get('name', ''))} is not understood")

    def init(self, board: Element) -> None:
        """Note where entities start, and how fast."""
        actions = board.find("Init/Actions")
        for private in () if actions is None else list(actions):
            if private.tag != "Private":
                self.losses.append(f"Init: {_innermost(private)} is not understood")
                continue
            name = self.text(private, "entityRef")
            for action in private:
                self._try(f"Init: {name}", self._private, [name], action, 0.0, True)

    def act(self, act: Element, place: str) -> None:
        """Note what an act's events do."""
        begins = self._try(f"{place}: StartTrigger", self._trigger, act.find("StartTrigger"), 0.0)
        # without conditions a stop trigger stops nothing
        if act.find("StopTrigger//Condition") is not None:
            self.losses.append(f"{place}: StopTrigger is not understood")
        if begins is None:
            return
        for group in act.iter("ManeuverGroup"):
            names = [self.text(one, "entityRef") for one in group.findall("Actors/EntityRef")]
            if group.find("CatalogReference") is not None:
                self.losses.append(f"{place}/{group.get('name', '')}: CatalogReference is not understood")
            for event in group.iter("Event"):
                here = f"{place}/{event.get('name', 'Event')}"
                starts = self._try(f"{here}: StartTrigger", self._trigger, event.find("StartTrigger"), begins)
                if starts is None:
                    continue
                for action in event.findall("Action"):
                    for kind in action:
                        own = self._private if kind.tag == "PrivateAction" else self._global
                        self._try(f"{here}/{action.get('name', 'Action')}", own, names, kind, starts, False)

    def _try(self, place: str, read: Callable[..., float | None], *arguments: object) -> float | None:
        try:
            return read(*arguments)
        except _NotUnderstoodError as fault:
            self.losses.append(f"{place}: {fault} is not understood")
            return None

    def _trigger(self, trigger: Element | None, begins: float) -> float:
        """When a trigger is met: not before ``begins``."""
        if trigger is None:
            return begins
        groups = trigger.findall("ConditionGroup")
        if len(groups) > 1:
            raise _NotUnderstoodError("one of several groups of conditions")
        found = begins
        for condition in groups[0] if groups else ():
            time = condition.find("ByValueCondition/SimulationTimeCondition")
            if time is None:
                raise _NotUnderstoodError(_innermost(condition))
            if self.text(time, "rule") not in ("greaterThan", "greaterOrEqual", "equalTo"):
                raise _NotUnderstoodError(f"SimulationTimeCondition with the rule {short(time.get('rule'))}")
            found = max(found, self.number(time, "value") + self.number(condition, "delay", "0"))
        return found

    def _entity(self, name: str) -> _Entity:
        if name not in self.known:
            raise ScenarioError(f"{self.path}: entityRef: there is no entity {short(name)}")
        return self.known[name]

    def _private(self, names: list[str], action: Element, time_s: float, starts: bool) -> None:
        entities = [self._entity(name) for name in names]
        teleport, speed = action.find("TeleportAction/Position"), action.find("LongitudinalAction/SpeedAction")
        follow = action.find("RoutingAction/FollowTrajectoryAction")
        if teleport is not None and starts:
            place = self._position(teleport)
            for entity in entities:
                entity.start = place
        elif speed is not None:
            change = self._speed(speed, time_s)
            for entity in entities:
                entity.speeds.append(change)
        elif follow is not None:
            keys = self._trajectory(follow, time_s)
            for entity in entities:
                entity.keys.append(keys)
        else:
            raise _NotUnderstoodError(_innermost(action))

    def _global(self, names: list[str], action: Element, time_s: float, starts: bool) -> None:
        del names, starts
        one = action.find("EntityAction")
        added = None if one is None else one.find("AddEntityAction/Position")
        if one is not None and added is not None:
            entity = self._entity(self.text(one, "entityRef"))
            entity.start, entity.appears_s = self._position(added), time_s
        elif one is not None and one.find("DeleteEntityAction") is not None:
            self._entity(self.text(one, "entityRef")).vanishes_s = time_s
        else:
            raise _NotUnderstoodError(_innermost(action))

    def _position(self, position: Element) -> Position:
        world = position.find("WorldPosition")
        if world is None:
            raise _NotUnderstoodError(_innermost(position))
        return {name: self.number(world, name, "0") for name in ("x", "y", "z", "h", "p", "r")}

    def _speed(self, speed: Element, time_s: float) -> tuple[float, float, str, float]:
        target = speed.find("SpeedActionTarget/AbsoluteTargetSpeed")
        dynamics = speed.find("SpeedActionDynamics")
        if target is None or dynamics is None:
            raise _NotUnderstoodError("SpeedAction without an AbsoluteTargetSpeed")
        shape, dimension = self.text(dynamics, "dynamicsShape"), self.text(dynamics, "dynamicsDimension")
        value = self.number(target, "value")
        if value < 0:
            raise _NotUnderstoodError("SpeedAction backward")
        if shape == "step":
            return time_s, value, "time", 0.0
        if shape != "linear" or dimension not in ("time", "rate"):
            raise _NotUnderstoodError(f"SpeedAction with {shape} dynamics by {dimension}")
        return time_s, value, dimension, abs(self.number(dynamics, "value"))

    def _trajectory(self, follow: Element, time_s: float) -> tuple[list[float], list[Position]]:
        trajectory = follow.find("TrajectoryRef/Trajectory")
        trajectory = follow.find("Trajectory") if trajectory is None else trajectory
        if trajectory is None:
            raise _NotUnderstoodError("FollowTrajectoryAction by a catalog")
        line = trajectory.find("Shape/Polyline")
        if line is None:
            raise _NotUnderstoodError(_innermost(trajectory))
        timing = follow.find("TimeReference/Timing")
        vertices = line.findall("Vertex")
        if timing is None or any(one.get("time") is None for one in vertices):
            raise _NotUnderstoodError("FollowTrajectoryAction without times")
        offset, scale = self.number(timing, "offset"), self.number(timing, "scale")
        begins = time_s if self.text(timing, "domainAbsoluteRelative") == "relative" else 0.0
        times, places = [], []
        for vertex in vertices:
            position = vertex.find("Position")
            if position is None:
                raise ScenarioError(f"{self.path}: Vertex: has no Position")
            times.append(begins + offset + scale * self.number(vertex, "time"))
            places.append(self._position(position))
            if len(times) > 1 and times[-1] <= times[-2]:
                raise ScenarioError(f"{self.path}: Vertex: time {times[-1]:g} s is not later than the one before")
        return times, places

    def track(self, name: str, entity: _Entity, span_s: tuple[float, float], recorded: Recorded) -> Track:
        """Return the track of all that is said of an entity."""
        begins = span_s[0] if entity.appears_s is None else entity.appears_s
        times: list[float] = []
        places: list[Position] = []
        if entity.keys:
            if entity.speeds:
                self.losses.append(f"entity {short(name)}: its trajectory has times: SpeedAction changes nothing")
            for new_times, new_places in sorted(entity.keys, key=lambda one: one[0][:1]):
                kept = sum(time < new_times[0] for time in times) if new_times else len(times)
                times, places = times[:kept] + new_times, places[:kept] + new_places
            if entity.start is not None and times and times[0] > begins + 1e-3:
                times, places = [begins, *times], [entity.start, *places]
        elif entity.speeds:
            track = recorded(name, entity.centre)
            times, places = _driven(entity, begins, span_s[1], track)
        elif entity.start is not None:
            times, places = [begins], [entity.start]
        return Track(times, places, entity.centre, entity.appears_s, entity.vanishes_s)


def _driven(
    entity: _Entity, begins: float, ends: float, recorded: Trajectory | None
) -> tuple[list[float], list[Position]]:
    """Return where an entity is that drives at its speeds: along its recorded path if it starts there, else straight on."""
    path = None if recorded is None else Path.recorded(recorded, begins, max(ends, begins), False)
    start = entity.start
    if start is None and recorded is not None:
        start = world_position(recorded.at(begins))
    if start is None:
        return [], []
    place = pose_at(start)
    s, aside = (0.0, math.inf) if path is None else path.project(start["x"], start["y"])
    if path is None or abs(aside) > BESIDE_M:
        x, y, z = place[:3, 3].tolist()
        path, s = Path.straight((x, y, z), start["h"]), 0.0
    times = np.arange(begins, ends + STEP_S / 2, STEP_S)
    found = []
    for before, after in zip([None, *times.tolist()], times.tolist(), strict=False):
        if before is not None:
            middle = (before + after) / 2
            s += _speed_at(entity.speeds, middle) * (after - before)
        position, quaternion = path.place(s)
        found.append(world_position(make_pose(np.array(position), np.array(quaternion))))
    return times.tolist(), found


def _speed_at(changes: list[tuple[float, float, str, float]], time_s: float) -> float:
    """Return the speed at a time after changes, each of which begins where the one before has come to."""
    speed, ordered = 0.0, sorted(changes, key=lambda one: one[0])
    for number, (begins, target, dimension, value) in enumerate(ordered):
        if begins > time_s:
            break
        until = min(time_s, ordered[number + 1][0]) if number + 1 < len(ordered) else time_s
        takes = value if dimension == "time" else abs(target - speed) / max(value, 1e-6)
        share = 1.0 if takes <= 0 else min(1.0, (until - begins) / takes)
        speed += share * (target - speed)
    return speed


def _innermost(element: Element) -> str:
    """Return the tag of the innermost action, condition, position or shape of an element."""
    found = element
    while True:
        inner = next(_named(found), None)
        if inner is None:
            return found.tag
        found = inner


def _named(element: Element) -> Iterator[Element]:
    for one in element:
        if one.tag.endswith(("Action", "Condition", "Position", "Nurbs", "Clothoid", "ClothoidSpline", "Shape")):
            yield one
