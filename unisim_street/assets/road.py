"""The ground: the course of the street, its plan, its known height, and the paint of carriageway, kerbs and pavements.

A course is straight pieces and arcs. A street's own coordinates are metres along it (x), and beside it to the left (y).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import FloatArray, make_pose, quaternion_from_yaw

from ..paint.materials import (
    Finish,
    Material,
    SurfaceMaterial,
    SurfacePoints,
    cover,
    hashed,
    linear,
    mix,
    noises,
    rectangle,
    stripes,
    surface,
)
from ..tracing.shapes import Sector, TracedShape, box
from ..tracing.trace import Asset, AssetPart

BEND_RADIUS_M = 40.0
"""Radius of every bend at the middle line, in metres."""
MIN_STRAIGHT_M = 60.0
"""Before the first bend, between bends and after the last the drive is straight for as long at least."""
MAX_TURN_DEG = 120.0
MIN_SELF_DISTANCE_M = 150.0
"""A street keeps as far from itself: houses, pavements and what a camera sees of them belong to one place of it."""


@dataclass(frozen=True)
class Piece:
    """A piece that begins at ``start`` (x, y) with a heading, at ``along`` metres; ``length`` metres long; ``curvature`` 1 / m,
    positive to the left, 0 where it is straight."""

    along: float
    length: float
    start: tuple[float, float]
    heading: float
    curvature: float

    def pose(self, s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places (N, 2) and headings (N,) of the middle line at ``s`` (N,), metres along the street."""
        run = s - self.along
        turned = self.heading + self.curvature * run
        if self.curvature:
            x = (np.sin(turned) - np.sin(self.heading)) / self.curvature
            y = (np.cos(self.heading) - np.cos(turned)) / self.curvature
        else:
            x, y = run * np.cos(self.heading), run * np.sin(self.heading)
        return np.stack([self.start[0] + x, self.start[1] + y], -1), turned

    def coordinates(self, points_xy: FloatArray, first: bool, last: bool) -> tuple[FloatArray, FloatArray]:
        """Metres along and beside the street (N,), (N,) of points (N, 2); beside is infinite where they lie beside another piece.
        The first and the last piece go on."""
        x, y = (points_xy - self.start).T
        cos, sin = np.cos(self.heading), np.sin(self.heading)
        ahead, left = cos * x + sin * y, cos * y - sin * x
        if self.curvature:
            side, radius = np.sign(self.curvature), 1 / abs(self.curvature)
            inward = radius - side * left
            run = np.arctan2(ahead, inward) * radius
            beside = side * (radius - np.hypot(ahead, inward))
        else:
            run, beside = ahead, left
        there = (first | (run >= 0)) & (last | (run <= self.length))
        return self.along + run, np.where(there, beside, np.inf)


class Course:
    """The way of a street whose drive is ``travel_m`` long, with bends of these degrees, positive to the left, evenly along it.

    Raises `LogError` where the drive is too short for them, or the street would cross itself.
    """

    def __init__(self, turns_deg: Sequence[float] = (), travel_m: float = 0.0) -> None:
        self.turns_deg = tuple(turns_deg)
        arcs = [abs(np.radians(turn)) * BEND_RADIUS_M for turn in self.turns_deg]
        gap = (travel_m - sum(arcs)) / (len(arcs) + 1)
        if arcs and gap < MIN_STRAIGHT_M:
            need = sum(arcs) + (len(arcs) + 1) * MIN_STRAIGHT_M
            raise LogError(
                f"a street with turns of {', '.join(f'{turn:g}' for turn in self.turns_deg)} degrees is for a drive of at least "
                f"{need:.0f} m, not {travel_m:.0f} m: more frames, or a higher speed"
            )
        pieces = [Piece(0.0, gap, (0.0, 0.0), 0.0, 0.0)]
        for turn, arc in zip(self.turns_deg, arcs, strict=True):
            pieces.append(_after(pieces[-1], arc, float(np.sign(turn)) / BEND_RADIUS_M))
            pieces.append(_after(pieces[-1], gap, 0.0))
        self.pieces = tuple(pieces)
        self._check_apart(travel_m)

    @classmethod
    def of_legs(
        cls, *legs: tuple[float, float], start: tuple[float, float] = (0.0, 0.0), heading: float = 0.0
    ) -> Course:
        """Return the way from ``start`` (x, y) of legs of metres and curvatures (1 / m, positive to the left)."""
        course = cls()
        pieces = [Piece(0.0, legs[0][0], start, heading, legs[0][1])]
        for length, curvature in legs[1:]:
            pieces.append(_after(pieces[-1], length, curvature))
        course.pieces = tuple(pieces)
        return course

    @property
    def is_straight(self) -> bool:
        """Whether its coordinates are those of the street's frame."""
        return len(self.pieces) == 1

    def place(self, x: FloatArray, y: FloatArray, yaw: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return x, y and headings (N,) in the street's frame of what is at these along, beside and against the street."""
        if self.is_straight:
            return x, y, yaw
        at, heading = self._middle_line(np.asarray(x, np.float64))
        return at[:, 0] - np.sin(heading) * y, at[:, 1] + np.cos(heading) * y, heading + yaw

    def coordinates(self, points_xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return metres along and beside the street (N,), (N,) of points (N, 2) of the street's frame: those of its nearest
        place."""
        if self.is_straight:
            return points_xy[:, 0], points_xy[:, 1]
        last = len(self.pieces) - 1
        own = [piece.coordinates(points_xy, i == 0, i == last) for i, piece in enumerate(self.pieces)]
        along, beside = (np.stack(values) for values in zip(*own, strict=True))
        nearest = np.abs(beside).argmin(0)[None]
        return np.take_along_axis(along, nearest, 0)[0], np.take_along_axis(beside, nearest, 0)[0]

    def stood(self, parts: list[AssetPart], x: float) -> list[AssetPart]:
        """Return parts that stand together round ``x`` of a straight street as they stand in this one."""
        if self.is_straight:
            return parts
        moved = self.pose(x)
        return [
            AssetPart(
                part.shape, part.material, moved if part.asset_from_part is None else moved @ part.asset_from_part
            )
            for part in parts
        ]

    def pose(self, x: float) -> FloatArray:
        """Return the pose (4, 4) that takes what stands round ``x`` of a straight street to where it stands in this one."""
        at, heading = self._middle_line(np.array([x]))
        pose = make_pose(np.array([*at[0], 0.0]), quaternion_from_yaw(float(heading[0])))
        pose[:3, 3] -= pose[:3, 0] * x
        return pose

    def _middle_line(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        number = np.searchsorted([piece.along for piece in self.pieces[1:]], x, side="right")
        at, heading = np.empty((len(x), 2)), np.empty(len(x))
        for i, piece in enumerate(self.pieces):
            here = number == i
            at[here], heading[here] = piece.pose(x[here])
        return at, heading

    def _check_apart(self, travel_m: float) -> None:
        if self.is_straight:
            return
        s = np.arange(-MIN_STRAIGHT_M, travel_m + 2 * MIN_STRAIGHT_M, 5.0)
        at = self._middle_line(s)[0]
        near = np.linalg.norm(at[:, None] - at[None], axis=-1) < MIN_SELF_DISTANCE_M
        # beyond a bend of the sharpest the two legs part so slowly
        if (near & (np.abs(s[:, None] - s[None]) > 2 * MIN_SELF_DISTANCE_M + np.pi * BEND_RADIUS_M)).any():
            raise LogError(
                f"a street with turns of {', '.join(f'{turn:g}' for turn in self.turns_deg)} degrees comes within "
                f"{MIN_SELF_DISTANCE_M:.0f} m of itself"
            )


def _after(piece: Piece, length: float, curvature: float) -> Piece:
    end = piece.along + piece.length
    at, heading = piece.pose(np.array([end]))
    return Piece(end, length, (float(at[0, 0]), float(at[0, 1])), float(heading[0]), curvature)


STRAIGHT_COURSE = Course()


LANE_WIDTH_M = 3.5
HALF_ROAD_WIDTH_M = 5.75
"""Half the carriageway: a lane and a parking lane on each side."""
HALF_STREET_WIDTH_M = 9.2
"""Distance of the house fronts from the middle line, in metres."""
KERB_HEIGHT_M = 0.13
GROUND_REACH_M = 1500.0
_GROUND_PAST_ENDS_M = 300.0
"""As far at least the ground goes on behind a street's ends."""
_PAVEMENT_REACH_M = 70.0


@dataclass(frozen=True)
class RoadPlan:
    """Properties of a road that differ between streets: the crossing's x range; patches (x, y, half_x, half_y) of newer
    asphalt; manholes (x, y)."""

    start_x: float
    end_x: float
    crossing: tuple[float, float]
    patches: tuple[tuple[float, float, float, float], ...]
    manholes: tuple[tuple[float, float], ...]
    course: Course = STRAIGHT_COURSE

    def height(self, points_xy: FloatArray) -> FloatArray:
        """The ground's height (N,) at x, y (N, 2) of the street's frame."""
        x, y = self.course.coordinates(points_xy)
        in_crossing = (x > self.crossing[0]) & (x < self.crossing[1])
        across = (x < self.start_x) | (x > self.end_x)
        return np.where((np.abs(y) < HALF_ROAD_WIDTH_M) | in_crossing | across, 0.0, KERB_HEIGHT_M)

    def asset(self) -> Asset:
        """The ground as parts: the carriageway's plane and four pavements."""
        reach = self.reach_m
        road = AssetPart(box((-reach, -reach, -1.0), (reach, reach, 0.0)), RoadPaint(self))
        parts = [road]
        for x0, x1 in ((self.start_x, self.crossing[0]), (self.crossing[1], self.end_x)):
            for side in (-1.0, 1.0):
                paint = PavementPaint((x0, x1), side, self.course)
                parts += [AssetPart(shape, paint, pose) for shape, pose in self._pavements(x0, x1, side)]
        return Asset("ground", tuple(parts))

    @property
    def reach_m(self) -> float:
        """How far the ground reaches from the street frame's origin, at least."""
        ends = max(abs(self.start_x), abs(self.end_x)) + _GROUND_PAST_ENDS_M
        return GROUND_REACH_M if ends < GROUND_REACH_M else ends

    def _pavements(self, x0: float, x1: float, side: float) -> Iterator[tuple[TracedShape, FloatArray | None]]:
        """The pavement of a side between two places along the street, piece by piece of its course."""
        y0, y1 = sorted((side * HALF_ROAD_WIDTH_M, side * _PAVEMENT_REACH_M))
        for number, piece in enumerate(self.course.pieces):
            begin = x0 if number == 0 else max(x0, piece.along)
            end = x1 if number == len(self.course.pieces) - 1 else min(x1, piece.along + piece.length)
            if begin >= end:
                continue
            if not piece.curvature:
                pose = None if self.course.is_straight else self.course.pose((begin + end) / 2)
                yield box((begin, y0, -0.5), (end, y1, KERB_HEIGHT_M), 0.02), pose
                continue
            bend, radius = np.sign(piece.curvature), 1 / abs(piece.curvature)
            near, far = (max(radius - bend * y, 0.0) for y in (side * HALF_ROAD_WIDTH_M, side * _PAVEMENT_REACH_M))
            middle, heading = piece.pose(np.array([(begin + end) / 2]))
            centre = middle[0] + bend * radius * np.array([-np.sin(heading[0]), np.cos(heading[0])])
            # a sector lies about its x axis, which looks from the bend's centre to the middle line
            pose = make_pose(np.array([*centre, 0.0]), quaternion_from_yaw(float(heading[0]) - bend * np.pi / 2))
            yield Sector(min(near, far), max(near, far), (end - begin) / radius / 2, -0.5, KERB_HEIGHT_M), pose


@dataclass(frozen=True)
class RoadPaint(Material):
    """Asphalt with wheel tracks, patches, seams, manholes and worn white marks."""

    plan: RoadPlan

    @property
    def finish(self) -> Finish:
        return Finish(0.85, grain_m=0.012, grain_height_m=0.002)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, y = self.plan.course.coordinates(p.asset[:, :2])
        foot, spread = p.footprint, p.spread
        grain, blotch = noises()["grain"], noises()["blotch"]
        stain = blotch(x, y, spread)
        tone = 0.13 * grain(x, y, spread) + 0.10 * stain + 0.07 * blotch(0.25 * x, 2.5 * y, spread)
        lane = np.abs(y) - LANE_WIDTH_M / 2
        track = np.exp(-(((np.abs(lane) - 0.78) / 0.26) ** 2))
        drip = np.exp(-((lane / 0.35) ** 2)) * (0.7 + 0.3 * stain)
        tone = tone + 0.10 * track * (np.abs(y) < LANE_WIDTH_M) - 0.16 * drip * (np.abs(y) < LANE_WIDTH_M)
        seam = cover(np.abs(np.abs(y) - LANE_WIDTH_M - 0.35 + 0.02 * stain) - 0.025, foot)
        parked = cover(LANE_WIDTH_M - np.abs(y) + 0.35, foot)
        tone = tone - 0.06 * parked - 0.35 * seam
        for px, py, hx, hy in self.plan.patches:
            edge = rectangle(x - px, y - py, hx, hy)
            tone = tone - 0.22 * cover(edge, foot) - 0.3 * cover(np.abs(edge) - 0.03, foot)
        gutter = cover(HALF_ROAD_WIDTH_M - 0.28 - np.abs(y), foot) * (np.abs(y) < HALF_ROAD_WIDTH_M + 0.01)
        albedo = linear("#67666a") * np.clip(1 + tone, 0.25, 2.0)[:, None]
        albedo = mix(albedo, linear("#8b8880") * (1 + 0.15 * stain)[:, None], 0.8 * gutter)
        metal = np.zeros(len(x))
        for mx, my in self.plan.manholes:
            r = np.hypot(x - mx, y - my)
            lid = cover(r - 0.34, foot)
            ring = cover(np.abs(r - 0.36) - 0.035, foot)
            chequer = np.sin(x * 62.0) * np.sin(y * 62.0) * np.clip(1.2 - spread / 0.04, 0, 1)
            albedo = mix(albedo, linear("#4a4643") * (1 + 0.25 * chequer)[:, None], lid)
            albedo = mix(albedo, linear("#343230"), ring)
            metal = np.maximum(metal, lid)
        wear = np.clip(
            0.93 + 0.11 * blotch(2 * x, 2 * y, 2 * spread) + 0.12 * grain(x, y, spread) - 0.25 * track, 0.2, 1
        )
        mark = self._marks(x, y, foot) * wear
        albedo = mix(albedo, linear("#dcdad2"), mark)
        base = surface(albedo).reflectivity * (1 - 0.4 * metal)
        return surface(albedo, 0.01, reflectivity=base * (1 - mark) + 0.75 * mark)

    def _marks(self, x: FloatArray, y: FloatArray, foot: FloatArray) -> FloatArray:
        """Coverage (N,) of paint: a dashed middle line, edge lines, stop lines and zebra stripes at the crossing."""
        low, high = self.plan.crossing
        away = np.maximum(low - 6.0 - x, x - high - 6.0)  # > 0: clear of the crossing and its zebras
        clear = cover(-away, foot)
        dash = cover(np.abs((x / 6.0) % 1.0 - 0.5) * 6.0 - 1.5, foot)
        mark = cover(np.abs(y) - 0.07, foot) * dash * clear
        edge = (
            cover(np.abs(np.abs(y) - LANE_WIDTH_M) - 0.05, foot)
            * cover(np.abs((x / 1.5) % 1.0 - 0.5) * 1.5 - 0.5, foot)
            * clear
        )
        mark = np.maximum(mark, edge)
        for middle, sense in ((low - 2.2, 1.0), (high + 2.2, -1.0)):
            bar = stripes(y + 0.5, 1.0, 0.5, foot) * (np.abs(y) < 5.0)
            mark = np.maximum(mark, cover(np.abs(x - middle) - 1.5, foot) * bar)
            own = (y < -0.2) if sense > 0 else (y > 0.2)
            stop = cover(np.abs(x - middle + sense * 2.6) - 0.2, foot) * own * (np.abs(y) < LANE_WIDTH_M - 0.1)
            mark = np.maximum(mark, stop)
        return np.asarray(mark)


@dataclass(frozen=True)
class PavementPaint(Material):
    """Slabs, a granite kerb along the road and round the corners, and darker edges where walls meet the ground."""

    reach_x: tuple[float, float]
    side: float
    course: Course = STRAIGHT_COURSE

    @property
    def finish(self) -> Finish:
        return Finish(0.85, grain_m=0.02, grain_height_m=0.001)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, beside = self.course.coordinates(p.asset[:, :2])
        y = np.abs(beside)
        foot, spread = p.footprint, p.spread
        grain, blotch = noises()["grain"], noises()["blotch"]
        row = np.floor((y - HALF_ROAD_WIDTH_M) / 0.6).astype(np.int64)
        shifted = x + 0.3 * (row % 2)
        slab = hashed(np.floor(shifted / 0.6).astype(np.int64), row, 11 + int(self.side))
        joint = np.maximum(stripes(shifted, 0.6, 0.018, spread), stripes(y - HALF_ROAD_WIDTH_M, 0.6, 0.018, spread))
        fade = np.clip(1.5 - spread / 0.3, 0, 1)
        stain = blotch(x + 3.0, y * self.side, spread)
        tone = 0.10 * stain + 0.05 * grain(x, y, spread) + 0.22 * (slab - 0.5) * fade - 0.4 * joint
        albedo = linear("#a29d94") * (1 + tone)[:, None]
        wall = np.exp(-np.maximum(HALF_STREET_WIDTH_M - y, 0.0) / 0.3)
        albedo = albedo * (1 - 0.35 * wall)[:, None]
        inward = np.minimum(y - HALF_ROAD_WIDTH_M, np.minimum(x - self.reach_x[0], self.reach_x[1] - x))
        kerb = cover(inward - 0.16, foot)
        upright = np.abs(p.normal[:, 2]) < 0.5
        along = np.where(y - HALF_ROAD_WIDTH_M < 0.17, x, beside)
        stone = hashed(np.floor(along).astype(np.int64), 5 + int(self.side))
        line = stripes(along, 1.0, 0.02, spread)
        granite = linear("#b3b0aa") * (1 + 0.07 * stain + 0.14 * (stone - 0.5) - 0.35 * line)[:, None]
        albedo = mix(albedo, granite, np.where(upright, 1.0, kerb))
        foot_dark = np.where(upright, 0.45 * np.exp(-np.maximum(p.asset[:, 2], 0) / 0.05), 0.0)
        return surface(albedo * (1 - foot_dark)[:, None])
