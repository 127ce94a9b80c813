"""The edit `row`."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ...geometry import BoolArray, FloatArray, Trajectory, Vector3, quaternion_from_matrix, rotation_from_angles
from ...world.drive import Actor, Drive
from ..checks import fail, require
from ..context import EditContext, actor_of, check_new, newcomer, with_actor
from ..edit import Edit, register
from ..json_schema import VECTOR, NotNegative, Positive, SchemaOf
from ..motion.maneuvers import DrivenPath
from ..types import Scenario

EGO = "ego"
OVERLAP_M = 0.1
"""Boxes are drawn generously: less than this is no collision."""
STRAIGHT_M = 10.0
"""Length of the path of a row along the actor's own axis."""
VARIED_LEFT, VARIED_RAD = 0.3, 0.05
"""By how much a row varies sideways and in heading, for each metre by which it varies along its path."""


@register
@dataclass(frozen=True)
class Row(Edit):
    """Copies of a recorded actor that stand evenly spaced beside a recorded or drawn path, or along its own axis; places
    where something else is stay free."""

    type = "row"
    seen_by = "actors"

    actor: str
    id: str
    start_m: float
    end_m: float
    count: Annotated[int, SchemaOf({"type": "integer", "minimum": 1, "maximum": 1000})] | None = None
    spacing_m: Positive | None = None
    along: str | None = None
    path: Annotated[tuple[Vector3, ...], SchemaOf({"type": "array", "items": VECTOR, "minItems": 2})] | None = None
    left_m: float | None = None
    end_left_m: float | None = None
    variation_m: NotNegative | None = None

    def check(self, scenario: Scenario, place: str) -> None:
        require(self.along is None or self.path is None, place, "has along beside path, which exclude each other")
        require((self.count is None) != (self.spacing_m is None), place, "needs count or spacing_m, and not both")

    def apply(self, drive: Drive, place: str, context: EditContext) -> Drive:
        """Return the drive with the copies, numbered from 1."""
        source = actor_of(context.recorded.actors, self.actor, f"{place}.actor", "in the log")
        poses, size_m = self.poses(standing(source), source.size_m, context.recorded, place), source.size_m
        times = np.array(sorted(context.recorded.time_s.values()))
        others = [
            (actor.world_from_actor.at(times[there]), actor.size_m)
            for actor in drive.actors.values()
            if (there := (times >= actor.start_s) & (times <= actor.end_s)).any()
        ]
        start, end = context.presence(None, place)
        for number, pose in enumerate(poses[clear(poses, size_m, others)], 1):
            check_new(drive, uid := f"{self.id} {number}", place, context)
            turn = quaternion_from_matrix(pose[None, :3, :3])
            drive = with_actor(
                drive, newcomer(source, uid, Trajectory(np.zeros(1), pose[None, :3, 3], turn), start, end)
            )
        return drive

    def course(self, origin: FloatArray, drive: Drive, place: str) -> DrivenPath:
        """Return the path of the row of copies of what stands at a pose (4, 4). Raises `ScenarioError` where there is
        none."""
        if self.path is not None:
            points: FloatArray = np.array(self.path, float)
        elif self.along is None:
            points = origin[:3, 3] + np.outer([0.0, STRAIGHT_M], origin[:3, 0])
        elif self.along == EGO:
            points = drive.world_from_ego.positions
        else:
            points = actor_of(drive.actors, self.along, f"{place}.along", "in the log").world_from_actor.positions
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1) + 1e-9))
        course = DrivenPath.of(Trajectory(lengths, points, np.tile([1.0, 0.0, 0.0, 0.0], (len(points), 1))))
        if course is None:
            fail(f"{place}.along", "this goes nowhere, so nothing can stand along it")
        return course

    def poses(self, origin: FloatArray, size_m: FloatArray, drive: Drive, place: str) -> FloatArray:
        """Return the poses (N, 4, 4) of all places, whatever else is there, for copies of a box of a size (3,) that stands
        at a pose (4, 4)."""
        course = self.course(origin, drive, place)
        gone, _, above = course.nearest(origin[:3, 3])
        heading = (
            0.0
            if self.path is not None
            else np.arctan2(origin[1, 0], origin[0, 0]) - course.beside(np.array([gone]))[1][0]
        )
        count = int(self.count or 1 + max(self.end_m - self.start_m, 0.0) / (self.spacing_m or 1.0) + 1e-6)
        share = np.linspace(0, 1, count)
        if self.spacing_m is not None:
            share = self.spacing_m * np.arange(count) / max(self.end_m - self.start_m, 1e-9)
        varied = (self.variation_m or 0.0) * np.random.default_rng(0).uniform(-1, 1, (count, 3))
        left_m = self.left_m or 0.0
        end_left_m = left_m if self.end_left_m is None else self.end_left_m
        along = self.start_m + share * (self.end_m - self.start_m) + varied[:, 0]
        left = left_m + share * (end_left_m - left_m) + VARIED_LEFT * varied[:, 1]
        places, headings = course.beside(along, left)
        poses = np.tile(np.eye(4), (count, 1, 1))
        poses[:, :3, :3] = rotation_from_angles(headings + heading + VARIED_RAD * varied[:, 2], *np.zeros((2, count)))
        poses[:, :3, 3] = places + [0.0, 0.0, size_m[2] / 2 if self.path is not None else above]
        return poses


def standing(actor: Actor) -> FloatArray:
    """Return the pose (4, 4) of a recorded actor of which a row has copies: its first."""
    return np.asarray(actor.world_from_actor.at(actor.world_from_actor.times_s[0]))


def clear(poses: FloatArray, size_m: FloatArray, others: Iterable[tuple[FloatArray, FloatArray]]) -> BoolArray:
    """Return which boxes (N,), of one size (3,) at poses (N, 4, 4), meet no other, seen from above. Each other is a box of
    a size (3,) at poses (T, 4, 4)."""
    free, own = np.ones(len(poses), bool), footprints(poses, size_m)
    for there, other_m in others:
        reach = float(np.linalg.norm(size_m[:2]) + np.linalg.norm(other_m[:2])) / 2
        near = np.linalg.norm(poses[:, None, :2, 3] - there[None, :, :2, 3], axis=-1) < reach
        for i in np.flatnonzero(near.any(1) & free):
            free[i] = not meet(own[i : i + 1], footprints(there[near[i]], other_m)).any()
    return free


def footprints(poses: FloatArray, size_m: FloatArray) -> FloatArray:
    """Return corners (N, 4, 2) of boxes from above, in order, made smaller by `OVERLAP_M`."""
    half = np.maximum(size_m[:2] - OVERLAP_M, 1e-3) / 2 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])
    return np.asarray(poses[:, None, :2, 3] + half @ np.swapaxes(poses[:, :2, :2], -1, -2))


def meet(a: FloatArray, b: FloatArray) -> BoolArray:
    """Return whether rectangles, corners (N, 4, 2) and (N, 4, 2), have a point in common: neither has an edge that parts
    them."""
    apart: BoolArray = np.zeros(np.broadcast_shapes(a.shape, b.shape)[0], bool)
    for corners in (a, b):
        edges = np.swapaxes(np.diff(corners[:, :3], axis=1), -1, -2)
        first, second = a @ edges, b @ edges
        apart |= ((first.max(1) < second.min(1)) | (second.max(1) < first.min(1))).any(-1)
    return ~apart
