"""The default place of an inserted actor: in front of the ego vehicle, along the nearest path, at its speed, clear of
what is there."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from ...core.actor_images.names import group_of
from ...core.geometry import BoolArray, FloatArray, matrix_from_quaternion, quaternion_from_matrix
from ...core.scenario.motion.paths import is_path, shifted_along
from ...core.simulation.footprints import directions, overlap
from ...core.simulation.vehicle.parameters import Vehicle
from ...core.world import classes
from .kinematics import Limits, exceeded, motion_of

HEADWAY_S = 1.5
"""Time from the ego's front to the actor's rear, in seconds of driving; never less than `GAP_M`."""
GAP_M = 6.0
CLEAR_M = 2.0, 0.4
"""Free room in front of and behind an actor that moves, and beside any."""
FARTHEST_M, STEP_M = 80.0, 2.0
"""Farther places are not tried, and by how much they differ."""
ASIDE_M = tuple(side * distance for distance in np.arange(2.0, 6.1, 0.5).tolist() for side in (-1.0, 1.0))
"""Places beside the ego's path of what stands, to the left; the nearest and the right ones first."""
NEAR_M = 10.0
"""How far aside of the place another actor's path may be that is followed."""
SAME_WAY = 0.5
"""Cosine of the angle to the ego's direction from which on a path leads the same way."""
GROUPS_BY_PATH = {
    "CAR": ("CAR", "TRUCK"),
    "TRUCK": ("CAR", "TRUCK"),
    "CYCLE": ("CYCLE", "CAR", "TRUCK"),
    "PERSON": ("PERSON",),
}
"""By the group of an actor: those whose paths it can follow. Those with CAR follow the ego, too."""


class Neighbour(NamedTuple):
    """What is there at N frames: poses (N, 4, 4), whether it is present (N,), its class and its size (3,)."""

    poses: FloatArray
    there: BoolArray
    label: str
    size_m: FloatArray


class FollowedCurve(NamedTuple):
    """Poses (N, 4, 4) that an actor follows, how high they are above the ground (None: as an ego frame), and by how
    much the nearest place is ahead of them along their path."""

    poses: FloatArray
    height_m: float | None
    ahead_m: float


class InsertPlace(NamedTuple):
    """Poses (N, 4, 4) on or beside a path, which is at the ``road`` (3,) at the shown frame. Origins of its poses are
    ``height_m`` above the ground, or as high as an ego frame is where that is None. ``stands``: at one pose."""

    poses: FloatArray
    road: FloatArray
    height_m: float | None
    stands: bool

    def on_ground(self, ground_m: float | None, actor_m: float) -> FloatArray:
        """Return poses (N, 4, 4) of an actor ``actor_m`` high that stands on the ground, whose z at the ``road`` is
        ``ground_m``; None where nothing tells."""
        height = self.height_m
        if height is None:
            height = 0.0 if ground_m is None else float(self.road[2]) - ground_m
        poses = self.poses.copy()
        poses[:, 2, 3] += actor_m / 2 - height
        return poses


def place_ahead(
    label: str, size_m: FloatArray, ego: FloatArray, others: Sequence[Neighbour], at: int, times_s: FloatArray
) -> InsertPlace:
    """Return where an actor of a class and a size (3,) is put: the first place that is clear at all N frames, else
    the one that is clear at most of them.

    ``ego`` (N, 4, 4) are the ego's poses at ``times_s`` (N,), ``at`` is the index of the shown frame.
    """
    length, width = float(size_m[0]), float(size_m[1])
    vehicle = Vehicle()
    speed_m_s = float(motion_of(ego[:, :3, 3], times_s).speed_m_s[at])
    nearest = vehicle.length_m - vehicle.rear_overhang_m + max(GAP_M, HEADWAY_S * speed_m_s) + length / 2
    taken, there = taken_by(ego, others)
    best, fewest = None, np.inf
    for place in _places(ego, _followed(label, ego, others, at, nearest, times_s), at, nearest):
        along, beside = (0.0, CLEAR_M[1]) if place.stands else CLEAR_M
        meets = overlap(_boxes(place.poses, length + 2 * along, width + 2 * beside)[None], taken) & there
        count = float(meets.sum() + meets.size * meets[:, at].any())
        if count < fewest:
            best, fewest = place, count
        if count == 0:
            break
    assert best is not None  # there are always places
    return best


def heading_along(point: FloatArray, paths: Sequence[FloatArray]) -> float:
    """Return the direction at a point (3,) of the nearest of some paths of poses (N, 4, 4), in radians about z; 0 where none
    leads anywhere."""
    leading = [path for path in paths if is_path(path[:, :3, 3])]
    if not leading:
        return 0.0
    poses = np.concatenate(leading)
    nearest = poses[np.linalg.norm((poses[:, :3, 3] - point)[:, :2], axis=1).argmin()]
    return float(np.arctan2(nearest[1, 0], nearest[0, 0]))


def taken_by(ego: FloatArray, others: Sequence[Neighbour]) -> tuple[FloatArray, BoolArray]:
    """Return the boxes (A, N, 5) in the plane of the ego vehicle, at poses (N, 4, 4), and of others, and when they are
    present (A, N)."""
    vehicle = Vehicle()
    boxes = [
        _boxes(ego, vehicle.length_m, vehicle.width_m, vehicle.length_m / 2 - vehicle.rear_overhang_m),
        *(_boxes(other.poses, float(other.size_m[0]), float(other.size_m[1])) for other in others),
    ]
    return np.stack(boxes), np.stack([np.ones(len(ego), bool), *(other.there for other in others)])


def meetings(
    poses: FloatArray, present: BoolArray, size_m: FloatArray, taken: FloatArray, there: BoolArray
) -> BoolArray:
    """Return whether an actor at poses (N, 4, 4), present (N,), overlaps each of the boxes (A, N, 5) that are ``there``
    (A, N): (A, N)."""
    return np.asarray(overlap(_boxes(poses, float(size_m[0]), float(size_m[1]))[None], taken) & there & present)


def _places(ego: FloatArray, paths: Sequence[FollowedCurve], at: int, nearest_m: float) -> Iterator[InsertPlace]:
    """Yield places on paths, else beside the ego's, in the order in which they are tried."""
    farther = np.arange(0.0, max(FARTHEST_M - nearest_m, STEP_M), STEP_M)
    for path, height, start in paths:
        for distance in start + farther:
            poses = _shifted(path, distance)
            yield InsertPlace(poses, poses[at, :3, 3], height, False)
    if paths:
        return
    moves = is_path(ego[:, :3, 3])
    for distance in nearest_m + farther:
        pose = _shifted(ego, distance)[at] if moves else _ahead(ego[at], distance)
        for left in ASIDE_M if moves else (0.0, *ASIDE_M):
            beside = pose.copy()
            beside[:3, 3] += left * pose[:3, 1]
            yield InsertPlace(np.tile(beside, (len(ego), 1, 1)), pose[:3, 3], None, True)


def _followed(
    label: str, ego: FloatArray, others: Sequence[Neighbour], at: int, nearest_m: float, times_s: FloatArray
) -> list[FollowedCurve]:
    """Return what an actor of a class can follow throughout: the ego, then the nearest; what moves implausibly last.
    What stands follows nothing."""
    groups = () if classes.motion_of(label) == "still" else GROUPS_BY_PATH.get(group_of(label), ())
    wanted, ahead = _ahead(ego[at], nearest_m)[:3, 3], ego[at, :3, 0]
    paths = []
    for other in others:
        positions = other.poses[:, :3, 3]
        if group_of(other.label) not in groups or not other.there.all() or not is_path(positions):
            continue
        away = np.linalg.norm((positions - wanted)[:, :2], axis=1)
        close = int(away.argmin())
        if away[close] < NEAR_M and ("PERSON" in groups or other.poses[close, :3, 0] @ ahead > SAME_WAY):
            gone = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1)))
            beyond = any(where.any() for where in exceeded(motion_of(positions, times_s), Limits()).values())
            path = FollowedCurve(other.poses, float(other.size_m[2]) / 2, float(gone[close] - gone[at]))
            paths.append((beyond, float(away[close]), path))
    paths.sort(key=lambda path: path[:2])
    own = [FollowedCurve(ego, None, nearest_m)] if "CAR" in groups and is_path(ego[:, :3, 3]) else []
    return [*own, *(path for *_, path in paths)]


def _shifted(poses: FloatArray, ahead_m: float) -> FloatArray:
    """Return poses (N, 4, 4) moved along their own path."""
    moved = poses.copy()
    moved[:, :3, 3], turns = shifted_along(poses[:, :3, 3], quaternion_from_matrix(poses[:, :3, :3]), ahead_m)
    moved[:, :3, :3] = matrix_from_quaternion(turns)
    return moved


def _ahead(pose: FloatArray, distance_m: float) -> FloatArray:
    moved = pose.copy()
    moved[:3, 3] += distance_m * pose[:3, 0]
    return moved


def _boxes(poses: FloatArray, length_m: float, width_m: float, forward_m: float = 0.0) -> FloatArray:
    """Return boxes (N, 5) in the plane, as `footprints` has them, their middles ``forward_m`` of the poses (N, 4, 4)."""
    heading = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
    middles = poses[:, :2, 3] + forward_m * directions(heading)
    return np.column_stack([middles, np.full(len(poses), length_m), np.full(len(poses), width_m), heading])
