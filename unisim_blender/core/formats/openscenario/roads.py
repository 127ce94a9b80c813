"""Roads of OpenSCENARIO: a recorded path stands for the one road that positions in lanes name.

Whatever needs another one is said. Of a road network only the side that traffic keeps to is read.
"""

from __future__ import annotations

import math
from collections.abc import Iterable

from ...errors import ScenarioError, short
from .document import Document, NotUnderstoodError, XmlNode, xml_root
from .entities import ALONG_RAD, Entity
from .paths import LANE_WIDTH_M, Curve, Lanes, OnRoad, lane_left

NEAR_M, OFF_GROUND_M = 20.0, 0.3
"""Distances, metres: a position this near to a recorded path, and this far above or below it, is not on the ground."""


class Roads:
    """The road that a recorded path stands for, if any, and the sides that traffic keeps to."""

    def __init__(self, document: Document, network: XmlNode | None) -> None:
        self.document, self._network = document, network
        self._lanes: Lanes | None = None
        self._left_hand: frozenset[str] | None = None
        self._said: set[tuple[str, str]] = set()

    def anchor(self, start: OnRoad, entity: Entity, start_s: float) -> None:
        """Have the recorded path of an entity, which is at a position on a road at ``start_s``, stand for that road."""
        curve = entity.recorded_curve
        if curve is None:
            place = entity.place(start_s)
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
                    self._left_hand = frozenset(road.get("id", "") for road in roads if road.get("rule") == "LHT")
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
        known = key in self._said
        self._said.add(key)
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

    def say_height(self, x_m: float, y_m: float, entities: Iterable[Entity]) -> None:
        """Say where a position without z lies above or below the recorded paths of entities near it."""
        for entity in entities:
            curve = entity.recorded_curve
            if curve is None or ("", "z") in self._said:
                continue
            s, left = curve.project(x_m, y_m)
            height = curve.at(s)[2]
            if abs(left) < NEAR_M and -NEAR_M < s < curve.length_m + NEAR_M and abs(height) > OFF_GROUND_M:
                self._said.add(("", "z"))
                self.document.say(
                    f"a WorldPosition without z has z = 0, where the recorded path of {short(entity.name)} is at {height:.3g} m"
                )

    def say_width(self) -> None:
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

    def lane_on(self, entity: Entity, lane: int) -> float:
        """Return how far left of an entity's path the middle of a lane of its road lies. Raises `NotUnderstoodError`."""
        lanes = self._lanes
        if lanes is None or entity.curve not in (lanes.curve, lanes.curve.reversed()):
            raise NotUnderstoodError(f"LaneChangeAction to lane {lane} of a road that no recorded path stands for")
        _, left = lanes.on(lanes.s_m, lane_left(lane))
        return left if entity.curve is lanes.curve else -left
