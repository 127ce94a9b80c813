"""Positions of OpenSCENARIO, and the trajectories and routes that are made of them.

A reader takes all attributes of an element at once, and returns what finds the place at a time: places beside entities move.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from ...errors import ScenarioError, short
from ...geometry import FloatArray
from .document import Document, NotUnderstoodError, XmlNode, read_child
from .entities import BACKWARD_RAD, Entity, Spot, driven
from .paths import LANE_WIDTH_M, Curve, OnRoad, Place, clothoid, lane_left, nurbs

if TYPE_CHECKING:
    from .storyboard import Storyboard

Locate = Callable[[float], Spot]
Places = Callable[["Entity | None", float], tuple[FloatArray, "FloatArray | None"]]
"""Gives places (N, 6) and their times (N,), if there are any, for an entity at a time."""


@dataclass(frozen=True)
class Line:
    """A trajectory: its places, whether it leads back to its start, and whether a place in the world has no heading."""

    places: Places
    closed: bool
    headless: bool


@dataclass(frozen=True)
class Orientation:
    """How a position is turned: in the file's world where it is ``absolute``, else from where it lies."""

    absolute: bool
    h: float
    p: float
    r: float

    def turned(self, place: Place) -> Place:
        """Return a place in the world turned as this says."""
        h, p, r = (0.0, 0.0, 0.0) if self.absolute else place[3:]
        return *place[:3], h + self.h, p + self.p, r + self.r


class Positions:
    """Reads the positions of a file."""

    def __init__(self, document: Document, board: Storyboard) -> None:
        self.document, self.board = document, board
        self.owner: str | None = None
        """The entity whose start is read."""
        self.on_roads: list[OnRoad] = []

    def position(self, node: XmlNode) -> Locate:
        """Read a Position as a function that gives the place at a time. Raises `NotUnderstoodError`."""
        readers: dict[tuple[str, ...], Callable[[XmlNode], Locate]] = {
            ("WorldPosition",): self._world,
            ("RelativeWorldPosition",): partial(self._beside, rotates=False),
            ("RelativeObjectPosition",): partial(self._beside, rotates=True),
            ("LanePosition",): self._lane,
            ("RoadPosition",): self._road,
            ("RelativeLanePosition",): self._beside_lane,
            ("RelativeRoadPosition",): self._beside_road,
            ("TrajectoryPosition",): self._on_trajectory,
            ("RoutePosition",): self._on_route,
        }
        return read_child(node, readers)

    def _world(self, node: XmlNode) -> Locate:
        x, y = node.number("x"), node.number("y")
        z, h, p, r = (node.number(name, "0") for name in ("z", "h", "p", "r"))
        says_z = node.has("z")

        def locate(time_s: float) -> Spot:
            if not says_z:
                self.board.roads.say_height(x, y, self.board.entities.values())
            return Spot((x, y, z, h, p, r))

        return locate

    def _orientation(self, node: XmlNode) -> Orientation:
        given = node.child("Orientation")
        if given is None:
            return Orientation(False, 0.0, 0.0, 0.0)
        absolute = given.choice("type", ("absolute", "relative"), "absolute") == "absolute"
        return Orientation(absolute, *(given.number(name, "0") for name in ("h", "p", "r")))

    def _on_path(self, node: XmlNode) -> Callable[[Curve, float, float, float, int], Spot]:
        """Read how a position on a path is turned: a function that gives it by path, arc length, distances to the left of itself
        and of its lane's middle, and 1 where the path runs along its road, else -1."""
        orientation = self._orientation(node)

        def spot(curve: Curve, s: float, left: float, lane: float, sign: int) -> Spot:
            self.board.roads.check_reach(curve, s, node)
            turn = self.board.roads.turned(curve, s, orientation.h, node) if orientation.absolute else orientation.h
            return driven(curve, s, left, lane, sign, (turn, orientation.p, orientation.r))

        return spot

    def _beside(self, node: XmlNode, rotates: bool) -> Locate:
        """Read a position beside an entity, along the world's axes or, where it ``rotates``, along the entity's. An axis that is
        not stated is 0, and said."""
        other = self.board.entity(node.text("entityRef"))
        for name in ("dx", "dy"):
            if not node.has(name):
                self.document.say(f"{node.tag} without {name}: it is taken as 0", node.place)
        dx, dy, dz = (node.number(name, "0") for name in ("dx", "dy", "dz"))
        orientation = self._orientation(node)

        def locate(time_s: float) -> Spot:
            x, y, z, h, p, r = self.board.place(other, time_s, node.tag)
            cos, sin = (math.cos(h), math.sin(h)) if rotates else (1.0, 0.0)
            place = x + dx * cos - dy * sin, y + dx * sin + dy * cos, z + dz, h, p, r
            return Spot(orientation.turned(place), beside=other)

        return locate

    def _on_road(self, road: str, s: float, left: float, offset: float, side: int, node: XmlNode) -> Locate:
        """Return what finds a place on a road: ``left`` of its reference line lies the lane's middle, ``side`` is that of its
        traffic: 1 along the road, -1 against it."""
        orientation, spot = self._orientation(node), self._on_path(node)
        if self.owner is not None:
            # who is turned round in its lane drives the other way
            absolute = orientation.absolute
            back = not absolute and math.cos(orientation.h) < math.cos(BACKWARD_RAD)
            heading = orientation.h if absolute else None
            self.on_roads.append(OnRoad(self.owner, road, s, left + offset, -side if back else side, heading))

        def locate(time_s: float) -> Spot:
            lanes = self.board.roads.lanes_of(road, node.tag)
            along, aside = lanes.on(s, left + offset)
            _, lane = lanes.on(s, left)
            if side == lanes.sign:
                return spot(lanes.curve, along, aside, lane, side)
            return spot(lanes.curve.reversed(), lanes.curve.length_m - along, -aside, -lane, side)

        return locate

    def _lane(self, node: XmlNode) -> Locate:
        road, name = node.text("roadId"), node.text("laneId")
        try:
            lane = int(name)
        except ValueError:
            raise NotUnderstoodError(f"LanePosition with the lane {short(name)}") from None
        s, offset = node.number("s"), node.number("offset", "0")
        return self._on_road(road, s, lane_left(lane), offset, self.board.roads.traffic(road, lane_left(lane)), node)

    def _road(self, node: XmlNode) -> Locate:
        road, s, t = node.text("roadId"), node.number("s"), node.number("t", "0")
        # without an Orientation it is headed along the road on either side
        return self._on_road(road, s, t, 0.0, 1, node)

    def _beside_lane(self, node: XmlNode) -> Locate:
        other = self.board.entity(node.text("entityRef"))
        lanes, in_lane = node.number("dLane"), node.has("dsLane")
        along = node.number("dsLane") if in_lane else node.number("ds", "0")
        offset, spot = node.number("offset", "0"), self._on_path(node)
        turned = node.child("Orientation") is not None and not self._orientation(node).absolute

        def locate(time_s: float) -> Spot:
            curve, s, _, lane, sign = self.board.path(other, time_s, node.tag)
            self.board.roads.say_counting(lanes, sign, node)
            back = turned and self.board.roads.is_against_traffic(curve, lane, sign)
            lane += sign * lanes * LANE_WIDTH_M
            # ds is the road's, dsLane counts as the other one's lane is driven
            s, left = s + (along if in_lane else sign * along), lane + sign * offset
            if not back:
                return spot(curve, s, left, lane, sign)
            # a relative heading counts from the other one's lane, not from where that one looks in it
            self.board.roads.say_turned(other, node)
            return spot(curve.reversed(), curve.length_m - s, -left, -lane, -sign)

        return locate

    def _beside_road(self, node: XmlNode) -> Locate:
        other = self.board.entity(node.text("entityRef"))
        ds, dt, spot = node.number("ds"), node.number("dt"), self._on_path(node)

        def locate(time_s: float) -> Spot:
            curve, s, left, _, sign = self.board.path(other, time_s, node.tag)
            return spot(curve, s + sign * ds, left + sign * dt, left + sign * dt, sign)

        return locate

    def _on_trajectory(self, node: XmlNode) -> Locate:
        s, t, orientation = node.number("s"), node.number("t", "0"), self._orientation(node)
        line = self.line(node.required("TrajectoryRef"))

        def locate(time_s: float) -> Spot:
            places, _ = line.places(None, time_s)
            curve = Curve.through(places, True)
            if curve is None:
                raise NotUnderstoodError("TrajectoryPosition on a trajectory without a length")
            return Spot(orientation.turned(curve.at(s, t)))

        return locate

    def _on_route(self, node: XmlNode) -> Locate:
        holder = node.child("RouteRef")
        route = None if holder is None else holder.child_or_entry("Route")
        within = node.child("InRoutePosition") or node
        along = None
        for tag in ("FromLaneCoordinates", "FromRoadCoordinates", "LaneCoord"):
            coordinates = within.child(tag)
            if coordinates is not None and coordinates.has("pathS"):
                along = coordinates
        if route is None or along is None:
            raise NotUnderstoodError(node.tag)
        lane = route.declaring().child("Waypoint", "Position", "LanePosition")
        if lane is not None:
            return self._on_first_road(route.declaring(), lane, along, node)
        s, spot = along.number("pathS"), self._on_path(node)
        # without the road's lanes it lies on the line through the waypoints
        left = along.number("laneOffset", "0") + along.number("t", "0")
        waypoints = self.waypoints(route)

        def locate(time_s: float) -> Spot:
            curve = Curve.through(waypoints(time_s), True)
            if curve is None:
                raise NotUnderstoodError("RoutePosition on a route without a length")
            return spot(curve, s, left, left, 1)

        return locate

    def _on_first_road(self, route: XmlNode, first: XmlNode, along: XmlNode, node: XmlNode) -> Locate:
        """Return what finds a place on a route whose first waypoint lies in a lane: on the road of that one."""
        self.waypoints(route)
        road, s, lane = first.text("roadId"), first.number("s"), int(first.number("laneId"))
        lanes = [waypoint.child("Position", "LanePosition") for waypoint in route.children("Waypoint")[1:]]
        side = self.board.roads.traffic(road, lane_left(lane))
        if lanes and lanes[0] is not None and lanes[0].text("roadId") == road:
            side = 1 if lanes[0].number("s") >= s else -1
        lane = int(along.number("laneId", repr(lane)))
        self.document.say(f"{node.tag}: pathS counts along road {short(road)}, that of its first waypoint", node.place)
        offset = along.number("laneOffset", "0")
        return self._on_road(road, s + side * along.number("pathS"), lane_left(lane), offset, side, node)

    def waypoints(self, route: XmlNode) -> Callable[[float], FloatArray]:
        route = route.declaring()
        if route.truth("closed", "false"):
            self.document.say('Route closed="true" is driven once', route.place)
        # where a route leads says nothing of where its driver starts
        owner, self.owner = self.owner, None
        every = self._vertices(route.children("Waypoint"))
        self.owner = owner
        if not every:
            raise ScenarioError(f"{self.document.path}: Route: has no Waypoint")
        return lambda time_s: np.array([locate(time_s).place for locate in every])

    def line(self, holder: XmlNode) -> Line:
        """Read a trajectory, there or in a catalog. Raises `NotUnderstoodError`."""
        trajectory = holder.child_or_entry("Trajectory")
        if trajectory is None:
            raise NotUnderstoodError("a trajectory that is not there")
        trajectory = trajectory.declaring()
        closed = trajectory.truth("closed", "false")

        def shape(read: Callable[[XmlNode], Places], node: XmlNode) -> Line:
            worlds = [vertex.child("Position", "WorldPosition") for vertex in node.children("Vertex")]
            headless = any(world is not None and not world.has("h") for world in worlds)
            return Line(read(node), closed, headless)

        shapes = {
            "Polyline": self._polyline,
            "Clothoid": self._clothoid,
            "ClothoidSpline": self._clothoids,
            "Nurbs": self._nurbs,
        }
        return read_child(trajectory, {("Shape", tag): partial(shape, read) for tag, read in shapes.items()})

    def _vertices(self, nodes: list[XmlNode]) -> list[Locate]:
        return [self.position(node.required("Position")) for node in nodes]

    def _polyline(self, node: XmlNode) -> Places:
        vertices = node.children("Vertex")
        if not vertices:
            raise ScenarioError(f"{self.document.path}: Polyline: has no Vertex")
        times = [vertex.optional_number("time") for vertex in vertices]
        places = self._vertices(vertices)
        known = None if None in times else np.array(times, float)
        if known is not None:
            for before, after in zip(known, known[1:], strict=False):
                if after <= before and known.any():
                    raise ScenarioError(
                        f"{self.document.path}: Vertex: time {after:g} s is not later than the one before"
                    )
            if len(known) > 1 and not known.any():
                known = None
        return lambda entity, time_s: (np.array([locate(time_s).place for locate in places]), known)

    def _clothoid(self, node: XmlNode) -> Places:
        first, length = node.number("curvature"), node.number("length")
        rate = node.number("curvaturePrime") if node.has("curvaturePrime") else node.number("curvatureDot", "0")
        (start,) = self._vertices([node])
        times = None
        if node.has("startTime") and node.has("stopTime"):
            times = node.number("startTime"), node.number("stopTime")

        def places(entity: Entity | None, time_s: float) -> tuple[FloatArray, FloatArray | None]:
            line = clothoid(start(time_s).place, first, first + rate * length, length)
            return line, None if times is None else np.linspace(*times, len(line))

        return places

    def _clothoids(self, node: XmlNode) -> Places:
        segments = node.children("ClothoidSplineSegment") or node.children("Segment")
        if not segments:
            raise ScenarioError(f"{self.document.path}: ClothoidSpline: has no segment")
        parts, starts, begins = [], [], []
        for segment in segments:
            parts.append((segment.number("curvatureStart"), segment.number("curvatureEnd"), segment.number("length")))
            begins.append(segment.optional_number("timeStart"))
            position, turn = segment.child("PositionStart"), segment.number("hOffset", "0")
            starts.append((None if position is None else self.position(position), turn))
        ends = node.optional_number("timeEnd")
        times = None if ends is None or None in begins else [begin or 0.0 for begin in begins] + [ends]

        def places(entity: Entity | None, time_s: float) -> tuple[FloatArray, FloatArray | None]:
            here = None if entity is None else entity.place(time_s)
            lines, own = [], []
            for number, (part, (start, turn)) in enumerate(zip(parts, starts, strict=True)):
                here = here if start is None else start(time_s).place
                if here is None:
                    raise NotUnderstoodError("ClothoidSpline without a PositionStart")
                line = clothoid((*here[:3], here[3] + turn, *here[4:]), *part)
                here = tuple(line[-1].tolist())
                skipped = 1 if number else 0
                lines.append(line[skipped:])
                if times is not None:
                    own.append(np.linspace(times[number], times[number + 1], len(line))[skipped:])
            return np.concatenate(lines), np.concatenate(own) if own else None

        return places

    def _nurbs(self, node: XmlNode) -> Places:
        order, controls = int(node.number("order")), node.children("ControlPoint")
        weights = np.array([control.number("weight", "1") for control in controls])
        knots = np.array([knot.number("value") for knot in node.children("Knot")])
        points = self._vertices(controls)
        if not 2 <= order <= len(points) or len(knots) != len(points) + order or (np.diff(knots) < 0).any():
            raise ScenarioError(f"{self.document.path}: Nurbs: order, control points and knots do not fit together")
        times = (
            np.array([control.number("time") for control in controls])
            if all(control.has("time") for control in controls)
            else None
        )
        if times is not None and (np.diff(times) <= 0).any():
            raise ScenarioError(f"{self.document.path}: ControlPoint: each time must be later than the one before")

        def places(entity: Entity | None, time_s: float) -> tuple[FloatArray, FloatArray | None]:
            corners = np.array([locate(time_s).place for locate in points])
            if times is None:
                return nurbs(order, corners, weights, knots), None
            # times are blended as places are, and so they grow along the curve
            curve = nurbs(order, np.concatenate([corners, times[:, None]], 1), weights, knots)
            is_later = np.concatenate([[True], np.diff(np.maximum.accumulate(curve[:, 6])) > 1e-6])
            return curve[is_later, :6], curve[is_later, 6]

        return places
