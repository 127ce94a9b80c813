"""Routing actions of OpenSCENARIO: along a trajectory, by its times or at a speed, along a route, or to a position."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from ...errors import ScenarioError, short
from ...geometry import FloatArray
from .document import Document, NotUnderstoodError, XmlNode
from .entities import Entity, Spot, TimedPlaces
from .motions import Done, Follows, Running
from .paths import TURN_S, Curve, along_itself, arc_lengths
from .positions import Positions

if TYPE_CHECKING:
    from .storyboard import Storyboard

Start = Callable[[Entity, float], Running]
"""Starts an action for an entity at a time. Raises `NotUnderstoodError`."""


class Routing:
    """Reads the routing actions of a file."""

    def __init__(self, document: Document, board: Storyboard, positions: Positions) -> None:
        self.document, self.board, self.positions = document, board, positions

    def trajectory(self, node: XmlNode) -> Start:
        """Read a FollowTrajectoryAction. Raises `NotUnderstoodError`."""
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

        def start(entity: Entity, time_s: float) -> Running:
            places, own = line.places(entity, time_s)
            if headless and not follows and len(places) > 1:
                self.document.say(
                    'a WorldPosition without h has the heading 0 where followingMode is "position"', place
                )
            if timing is not None and own is None:
                raise NotUnderstoodError("FollowTrajectoryAction without times")
            if closed and len(places) > 1:
                places = np.concatenate([places, places[:1]])
            if timing is None or own is None:
                return self._without_times(entity, places, follows, closed, skips, place, time_s)
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
                self.board.wake(float(times[0]))
            else:
                entity.keep_times(timed, time_s)
            return Follows(entity, timed)

        return start

    def _without_times(
        self, entity: Entity, places: FloatArray, follows: bool, closed: bool, skips: float, place: str, time_s: float
    ) -> Running:
        """Have an entity drive along places (N, 6) at its speed, from ``skips`` metres on."""
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

    def route(self, node: XmlNode) -> Start:
        """Read an AssignRouteAction. Raises `NotUnderstoodError`."""
        route = node.child_or_entry("Route")
        if route is None:
            raise NotUnderstoodError(node.tag)
        return self._drives_to(self.positions.waypoints(route), node)

    def acquire(self, node: XmlNode) -> Start:
        """Read an AcquirePositionAction. Raises `NotUnderstoodError`."""
        position = node.child("Position")
        if position is None:
            raise NotUnderstoodError(node.tag)
        locate = self.positions.position(position)
        return self._drives_to(lambda time_s: np.array([locate(time_s).place]), node)

    def _drives_to(self, waypoints: Callable[[float], FloatArray], node: XmlNode) -> Start:
        def start(entity: Entity, time_s: float) -> Running:
            places = waypoints(time_s)
            here = self.board.place(entity, time_s, node.tag)
            ahead = places
            if len(places) > 1:
                # what lies behind it is passed already
                line = Curve.through(places, True)
                s = 0.0 if line is None else line.project(here[0], here[1])[0]
                lengths = arc_lengths(places)
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


def _closing(times: FloatArray, places: FloatArray) -> FloatArray:
    """Return times with that of the way back from the last vertex to the first, at the speed of the part before it."""
    lengths = np.linalg.norm(np.diff(places[:, :2], axis=0), axis=1)
    speeds = lengths[:-1] / np.diff(times) if len(times) > 1 else np.array([1.0])
    moving = speeds[speeds > 1e-6]
    return np.append(times, times[-1] + max(float(lengths[-1]), 1e-3) / (float(moving[-1]) if len(moving) else 1.0))


def _skipped(times: FloatArray, places: FloatArray, length_m: float) -> tuple[FloatArray, FloatArray, float]:
    """Return a trajectory that starts so far along itself at its first time, and how much earlier it is everywhere."""
    along = arc_lengths(places)
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
