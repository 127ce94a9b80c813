"""Where a street leads: straight pieces and arcs. A street's own coordinates are metres along it, and beside it to the left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.errors import LogError
from unisim_blender.core.geometry import FloatArray, make_pose, quaternion_from_yaw

from ..tracing.trace import AssetPart

RADIUS_M = 40.0
"""Of every bend, at the middle line."""
LEAD_M = 60.0
"""Before the first bend, between bends and after the last the drive is straight for as long at least."""
MOST_DEG = 120.0
APART_M = 150.0
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
        arcs = [abs(np.radians(turn)) * RADIUS_M for turn in self.turns_deg]
        gap = (travel_m - sum(arcs)) / (len(arcs) + 1)
        if arcs and gap < LEAD_M:
            need = sum(arcs) + (len(arcs) + 1) * LEAD_M
            raise LogError(
                f"a street with turns of {', '.join(f'{turn:g}' for turn in self.turns_deg)} degrees is for a drive of at least "
                f"{need:.0f} m, not {travel_m:.0f} m: more frames, or a higher speed"
            )
        pieces = [Piece(0.0, gap, (0.0, 0.0), 0.0, 0.0)]
        for turn, arc in zip(self.turns_deg, arcs, strict=True):
            pieces.append(_after(pieces[-1], arc, float(np.sign(turn)) / RADIUS_M))
            pieces.append(_after(pieces[-1], gap, 0.0))
        self.pieces = tuple(pieces)
        self._check_apart(travel_m)

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
        found = [piece.coordinates(points_xy, i == 0, i == last) for i, piece in enumerate(self.pieces)]
        along, beside = (np.stack(values) for values in zip(*found, strict=True))
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
        s = np.arange(-LEAD_M, travel_m + 2 * LEAD_M, 5.0)
        at = self._middle_line(s)[0]
        near = np.linalg.norm(at[:, None] - at[None], axis=-1) < APART_M
        # beyond a bend of the sharpest the two legs part so slowly
        if (near & (np.abs(s[:, None] - s[None]) > 2 * APART_M + np.pi * RADIUS_M)).any():
            raise LogError(
                f"a street with turns of {', '.join(f'{turn:g}' for turn in self.turns_deg)} degrees comes within "
                f"{APART_M:.0f} m of itself"
            )


def _after(piece: Piece, length: float, curvature: float) -> Piece:
    end = piece.along + piece.length
    at, heading = piece.pose(np.array([end]))
    return Piece(end, length, (float(at[0, 0]), float(at[0, 1])), float(heading[0]), curvature)


STRAIGHT = Course()
