"""Positions of OpenSCENARIO, and the trajectories and routes that are made of them.

A reader takes all attributes of an element at once, and returns what finds the place at a time: places beside entities move.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ...errors import ScenarioError, short
from ...geometry import FloatArray
from .document import Document, NotUnderstoodError, XmlNode, innermost
from .entities import BACKWARD_RAD, Entity, Spot, driven
from .paths import LANE_WIDTH_M, Curve, Place, clothoid, lane_left, nurbs

if TYPE_CHECKING:
    from .storyboard import Storyboard

Locate = Callable[["Storyboard", float], Spot]
Places = Callable[["Storyboard", "Entity | None", float], tuple[FloatArray, "FloatArray | None"]]
"""Gives places (N, 6) and their times (N,), if there are any, for an entity at a time."""


@dataclass(frozen=True)
class Line:
    """A trajectory: its places, whether it leads back to its start, and whether a place in the world has no heading."""

    places: Places
    closed: bool
    headless: bool


@dataclass(frozen=True)
class OnRoad:
    """A position on a road in Init: its entity, how far along and left of the road's line it is, 1 where it is headed along the
    road, else -1, and its heading in the file's world where that is given."""

    entity: str
    road: str
    s_m: float
    left_m: float
    side: int
    heading: float | None


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
        kinds: dict[str, Callable[[XmlNode], Locate]] = {
            "WorldPosition": self._world,
            "RelativeWorldPosition": self._beside_world,
            "RelativeObjectPosition": self._beside_object,
            "LanePosition": self._lane,
            "RoadPosition": self._road,
            "RelativeLanePosition": self._beside_lane,
            "RelativeRoadPosition": self._beside_road,
            "TrajectoryPosition": self._on_trajectory,
            "RoutePosition": self._on_route,
        }
        for tag, read in kinds.items():
            found = node.child(tag)
            if found is not None:
                return read(found)
        raise NotUnderstoodError(innermost(node.element))

    def _world(self, node: XmlNode) -> Locate:
        x, y = node.number("x"), node.number("y")
        z, h, p, r = (node.number(name, "0") for name in ("z", "h", "p", "r"))
        says_z = node.has("z")

        def locate(board: Storyboard, time_s: float) -> Spot:
            if not says_z:
                board.say_height(x, y)
            return Spot((x, y, z, h, p, r))

        return locate

    def _orientation(self, node: XmlNode) -> Orientation:
        given = node.child("Orientation")
        if given is None:
            return Orientation(False, 0.0, 0.0, 0.0)
        absolute = given.choice("type", ("absolute", "relative"), "absolute") == "absolute"
        return Orientation(absolute, *(given.number(name, "0") for name in ("h", "p", "r")))

    def _on_path(self, node: XmlNode) -> Callable[[Storyboard, Curve, float, float, float, int], Spot]:
        """Read how a position on a path is turned: a function that gives it by path, arc length, distances to the left of itself
        and of its lane's middle, and 1 where the path runs along its road, else -1."""
        orientation = self._orientation(node)

        def spot(board: Storyboard, curve: Curve, s: float, left: float, lane: float, sign: int) -> Spot:
            board.check_reach(curve, s, node)
            turn = board.turned(curve, s, orientation.h, node) if orientation.absolute else orientation.h
            return driven(curve, s, left, lane, sign, (turn, orientation.p, orientation.r))

        return spot

    def _apart(self, node: XmlNode) -> tuple[float, float, float]:
        """Return how far a position is from another one's, axis by axis; what is not stated is 0, and said."""
        for name in ("dx", "dy"):
            if not node.has(name):
                self.document.say(f"{node.tag} without {name}: it is taken as 0", node.place)
        return node.number("dx", "0"), node.number("dy", "0"), node.number("dz", "0")

    def _beside_world(self, node: XmlNode) -> Locate:
        other = self.board.entity(node.text("entityRef"))
        dx, dy, dz = self._apart(node)
        orientation = self._orientation(node)

        def locate(board: Storyboard, time_s: float) -> Spot:
            x, y, z, h, p, r = board.place(other, time_s, node.tag)
            return Spot(orientation.turned((x + dx, y + dy, z + dz, h, p, r)), beside=other)

        return locate

    def _beside_object(self, node: XmlNode) -> Locate:
        other = self.board.entity(node.text("entityRef"))
        dx, dy, dz = self._apart(node)
        orientation = self._orientation(node)

        def locate(board: Storyboard, time_s: float) -> Spot:
            x, y, z, h, p, r = board.place(other, time_s, node.tag)
            cos, sin = math.cos(h), math.sin(h)
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

        def locate(board: Storyboard, time_s: float) -> Spot:
            lanes = board.lanes_of(road, node.tag)
            along, aside = lanes.on(s, left + offset)
            _, lane = lanes.on(s, left)
            if side == lanes.sign:
                return spot(board, lanes.curve, along, aside, lane, side)
            return spot(board, lanes.curve.reversed(), lanes.curve.length_m - along, -aside, -lane, side)

        return locate

    def _lane(self, node: XmlNode) -> Locate:
        road, name = node.text("roadId"), node.text("laneId")
        try:
            lane = int(name)
        except ValueError:
            raise NotUnderstoodError(f"LanePosition with the lane {short(name)}") from None
        s, offset = node.number("s"), node.number("offset", "0")
        return self._on_road(road, s, lane_left(lane), offset, self.board.traffic(road, lane_left(lane)), node)

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

        def locate(board: Storyboard, time_s: float) -> Spot:
            curve, s, _, lane, sign = board.path(other, time_s, node.tag)
            board.say_counting(lanes, sign, node)
            back = turned and board.is_against_traffic(curve, lane, sign)
            lane += sign * lanes * LANE_WIDTH_M
            # ds is the road's, dsLane counts as the other one's lane is driven
            s, left = s + (along if in_lane else sign * along), lane + sign * offset
            if not back:
                return spot(board, curve, s, left, lane, sign)
            # a relative heading counts from the other one's lane, not from where that one looks in it
            board.say_turned(other, node)
            return spot(board, curve.reversed(), curve.length_m - s, -left, -lane, -sign)

        return locate

    def _beside_road(self, node: XmlNode) -> Locate:
        other = self.board.entity(node.text("entityRef"))
        ds, dt, spot = node.number("ds"), node.number("dt"), self._on_path(node)

        def locate(board: Storyboard, time_s: float) -> Spot:
            curve, s, left, _, sign = board.path(other, time_s, node.tag)
            return spot(board, curve, s + sign * ds, left + sign * dt, left + sign * dt, sign)

        return locate

    def _on_trajectory(self, node: XmlNode) -> Locate:
        s, t, orientation = node.number("s"), node.number("t", "0"), self._orientation(node)
        reference = node.child("TrajectoryRef")
        if reference is None:
            raise ScenarioError(f"{self.document.path}: TrajectoryPosition: has no TrajectoryRef")
        line = self.line(reference)

        def locate(board: Storyboard, time_s: float) -> Spot:
            places, _ = line.places(board, None, time_s)
            curve = Curve.through(places, True)
            if curve is None:
                raise NotUnderstoodError("TrajectoryPosition on a trajectory without a length")
            return Spot(orientation.turned(curve.at(s, t)))

        return locate

    def _on_route(self, node: XmlNode) -> Locate:
        holder = node.child("RouteRef")
        route = None if holder is None else holder.child("Route")
        reference = None if holder is None else holder.child("CatalogReference")
        if reference is not None:
            route = self.document.catalog_entry(reference)
        within = node.child("InRoutePosition") or node
        along = None
        for tag in ("FromLaneCoordinates", "FromRoadCoordinates", "LaneCoord"):
            found = within.child(tag)
            if found is not None and found.has("pathS"):
                along = found
        if route is None or along is None:
            raise NotUnderstoodError(node.tag)
        lane = route.declaring().child("Waypoint", "Position", "LanePosition")
        if lane is not None:
            return self._on_first_road(route.declaring(), lane, along, node)
        s, spot = along.number("pathS"), self._on_path(node)
        # without the road's lanes it lies on the line through the waypoints
        left = along.number("laneOffset", "0") + along.number("t", "0")
        waypoints = self.waypoints(route)

        def locate(board: Storyboard, time_s: float) -> Spot:
            curve = Curve.through(waypoints(board, time_s), True)
            if curve is None:
                raise NotUnderstoodError("RoutePosition on a route without a length")
            return spot(board, curve, s, left, left, 1)

        return locate

    def _on_first_road(self, route: XmlNode, first: XmlNode, along: XmlNode, node: XmlNode) -> Locate:
        """Return what finds a place on a route whose first waypoint lies in a lane: on the road of that one."""
        self.waypoints(route)
        road, s, lane = first.text("roadId"), first.number("s"), int(first.number("laneId"))
        lanes = [one.child("Position", "LanePosition") for one in route.children("Waypoint")[1:]]
        side = self.board.traffic(road, lane_left(lane))
        if lanes and lanes[0] is not None and lanes[0].text("roadId") == road:
            side = 1 if lanes[0].number("s") >= s else -1
        lane = int(along.number("laneId", repr(lane)))
        self.document.say(f"{node.tag}: pathS counts along road {short(road)}, that of its first waypoint", node.place)
        offset = along.number("laneOffset", "0")
        return self._on_road(road, s + side * along.number("pathS"), lane_left(lane), offset, side, node)

    def waypoints(self, route: XmlNode) -> Callable[[Storyboard, float], FloatArray]:
        route = route.declaring()
        if route.truth("closed", "false"):
            self.document.say('Route closed="true" is driven once', route.place)
        every = []
        # where a route leads says nothing of where its driver starts
        owner, self.owner = self.owner, None
        for one in route.children("Waypoint"):
            position = one.child("Position")
            if position is None:
                raise ScenarioError(f"{self.document.path}: Waypoint: has no Position")
            every.append(self.position(position))
        self.owner = owner
        if not every:
            raise ScenarioError(f"{self.document.path}: Route: has no Waypoint")

        def places(board: Storyboard, time_s: float) -> FloatArray:
            return np.array([one(board, time_s).place for one in every])

        return places

    def line(self, holder: XmlNode) -> Line:
        """Read a trajectory, there or in a catalog. Raises `NotUnderstoodError`."""
        trajectory, reference = holder.child("Trajectory"), holder.child("CatalogReference")
        if trajectory is None and reference is not None:
            trajectory = self.document.catalog_entry(reference)
        if trajectory is None:
            raise NotUnderstoodError("a trajectory that is not there")
        trajectory = trajectory.declaring()
        closed, shape = trajectory.truth("closed", "false"), trajectory.child("Shape")
        for tag, read in (
            ("Polyline", self._polyline),
            ("Clothoid", self._clothoid),
            ("ClothoidSpline", self._clothoids),
            ("Nurbs", self._nurbs),
        ):
            found = None if shape is None else shape.child(tag)
            if found is not None:
                worlds = [vertex.child("Position", "WorldPosition") for vertex in found.children("Vertex")]
                headless = any(one is not None and not one.has("h") for one in worlds)
                return Line(read(found), closed, headless)
        raise NotUnderstoodError(innermost(trajectory.element))

    def _vertices(self, nodes: list[XmlNode]) -> list[Locate]:
        found = []
        for one in nodes:
            position = one.child("Position")
            if position is None:
                raise ScenarioError(f"{self.document.path}: {one.tag}: has no Position")
            found.append(self.position(position))
        return found

    def _polyline(self, node: XmlNode) -> Places:
        vertices = node.children("Vertex")
        if not vertices:
            raise ScenarioError(f"{self.document.path}: Polyline: has no Vertex")
        times = [one.number("time") if one.has("time") else None for one in vertices]
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
        return lambda board, entity, time_s: (np.array([one(board, time_s).place for one in places]), known)

    def _clothoid(self, node: XmlNode) -> Places:
        first, length = node.number("curvature"), node.number("length")
        rate = node.number("curvaturePrime") if node.has("curvaturePrime") else node.number("curvatureDot", "0")
        (start,) = self._vertices([node])
        times = None
        if node.has("startTime") and node.has("stopTime"):
            times = node.number("startTime"), node.number("stopTime")

        def places(board: Storyboard, entity: Entity | None, time_s: float) -> tuple[FloatArray, FloatArray | None]:
            found = clothoid(start(board, time_s).place, first, first + rate * length, length)
            return found, None if times is None else np.linspace(*times, len(found))

        return places

    def _clothoids(self, node: XmlNode) -> Places:
        segments = node.children("ClothoidSplineSegment") or node.children("Segment")
        if not segments:
            raise ScenarioError(f"{self.document.path}: ClothoidSpline: has no segment")
        parts, starts, begins = [], [], []
        for one in segments:
            parts.append((one.number("curvatureStart"), one.number("curvatureEnd"), one.number("length")))
            begins.append(one.number("timeStart") if one.has("timeStart") else None)
            position, turn = one.child("PositionStart"), one.number("hOffset", "0")
            starts.append((None if position is None else self.position(position), turn))
        ends = node.number("timeEnd") if node.has("timeEnd") else None
        times = None if ends is None or None in begins else [one or 0.0 for one in begins] + [ends]

        def places(board: Storyboard, entity: Entity | None, time_s: float) -> tuple[FloatArray, FloatArray | None]:
            here = None if entity is None else entity.place(time_s)
            found, own = [], []
            for number, (part, (start, turn)) in enumerate(zip(parts, starts, strict=True)):
                here = here if start is None else start(board, time_s).place
                if here is None:
                    raise NotUnderstoodError("ClothoidSpline without a PositionStart")
                line = clothoid((*here[:3], here[3] + turn, *here[4:]), *part)
                here = tuple(line[-1].tolist())
                skipped = 1 if number else 0
                found.append(line[skipped:])
                if times is not None:
                    own.append(np.linspace(times[number], times[number + 1], len(line))[skipped:])
            return np.concatenate(found), np.concatenate(own) if own else None

        return places

    def _nurbs(self, node: XmlNode) -> Places:
        order, controls = int(node.number("order")), node.children("ControlPoint")
        weights = np.array([one.number("weight", "1") for one in controls])
        knots = np.array([one.number("value") for one in node.children("Knot")])
        points = self._vertices(controls)
        if not 2 <= order <= len(points) or len(knots) != len(points) + order or (np.diff(knots) < 0).any():
            raise ScenarioError(f"{self.document.path}: Nurbs: order, control points and knots do not fit together")
        times = np.array([one.number("time") for one in controls]) if all(one.has("time") for one in controls) else None
        if times is not None and (np.diff(times) <= 0).any():
            raise ScenarioError(f"{self.document.path}: ControlPoint: each time must be later than the one before")

        def places(board: Storyboard, entity: Entity | None, time_s: float) -> tuple[FloatArray, FloatArray | None]:
            corners = np.array([one(board, time_s).place for one in points])
            if times is None:
                return nurbs(order, corners, weights, knots), None
            # times are blended as places are, and so they grow along the curve
            found = nurbs(order, np.concatenate([corners, times[:, None]], 1), weights, knots)
            kept = np.concatenate([[True], np.diff(np.maximum.accumulate(found[:, 6])) > 1e-6])
            return found[kept, :6], found[kept, 6]

        return places
