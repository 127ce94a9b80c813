"""Conversion of annotated boxes, one a frame, to actors: the times at which the beams passed them, and which of them
move.

A box is drawn around the returns of a turning LiDAR, so the object was there when the beams passed it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import LogError
from ..geometry import (
    FloatArray,
    Trajectory,
    TrajectoryError,
    intersect_boxes,
    invert_pose,
    points_in_box,
    quaternion_from_matrix,
)
from .classes import motion_of
from .drive import Actor, Appearance, Drive, Lidar

ROUNDS = 3
"""Number of iterations for the time at which an actor is passed, which depends on its place then."""


def box_poses(drive: Drive, lidar: Lidar, frame: int) -> tuple[list[Actor], FloatArray]:
    """Return the actors that a frame's labels list, those present when the beams of the frame's sweep pass them, and
    their poses (N, 4, 4) in the world then."""
    every = drive.labelled_actors
    passed = passing(every, lidar, lidar.time_s[frame])
    there = [at for at, actor in enumerate(every) if actor.present(passed[at])]
    actors, times = [every[at] for at in there], passed[there]
    poses = [actor.world_from_actor.at(time) for actor, time in zip(actors, times, strict=True)]
    return actors, np.array(poses).reshape(-1, 4, 4)


def passing(actors: Sequence[Actor], lidar: Lidar, frame_time_s: float) -> FloatArray:
    """Return the times (N,), seconds, at which the beams of the sweep at a frame's time pass each actor."""
    times = np.full(len(actors), frame_time_s)
    if not len(actors):
        return times
    for _ in range(ROUNDS):
        places = [actor.world_from_actor.positions_at(time) for actor, time in zip(actors, times, strict=True)]
        times = passing_times(lidar, np.array(places), np.full(len(actors), frame_time_s))
    return times


INNER = 0.8
"""Factor on the edges of a box for the inner box whose rays count: those along its edges end on the ground beside it,
too."""
BEFORE_M = 0.3
"""Distance before a box, metres, at which a ray that ends there is stopped by something else."""


def hidden_shares(
    origins: FloatArray, points: FloatArray, poses: FloatArray, sizes_m: FloatArray
) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the share (A,) of the rays towards each box that end before it, NaN where none goes there, and the number
    (A,) of returns in each box; of boxes with ``poses`` (A, 4, 4) and ``sizes_m`` (A, 3), and rays from ``origins`` (N,
    3) to returns ``points`` (N, 3), world frame.

    Dropped rays do not count.
    """
    assert origins.shape == points.shape == (len(points), 3), (origins.shape, points.shape)
    assert poses.shape[:1] == np.shape(sizes_m)[:1], (poses.shape, np.shape(sizes_m))
    ways = points - origins
    distance = np.linalg.norm(ways, axis=1)
    rays = ways / np.maximum(distance, 1e-9)[:, None]
    shares, inside = np.full(len(sizes_m), np.nan), np.zeros(len(sizes_m), np.int64)
    for at, (pose, size) in enumerate(zip(poses, np.asarray(sizes_m), strict=True)):
        aside = pose[:3, 3] - origins
        away, radius = np.linalg.norm(aside, axis=1), float(np.linalg.norm(size)) / 2
        # of a ray that begins in the box's ball any may meet it
        ahead = np.sqrt(np.maximum(away**2 - radius**2, 0.0))
        near = np.flatnonzero((away <= radius) | ((rays * aside).sum(1) >= ahead))
        if not len(near):
            continue
        inside[at] = points_in_box(points[near], pose, size).sum()
        # the inner box and the whole one
        sizes, places = np.stack([INNER * size, size]), np.broadcast_to(invert_pose(pose), (2, 4, 4))
        enter, leave = intersect_boxes(origins[near], rays[near], places, sizes)
        met = (enter[:, 0] <= leave[:, 0]) & (leave[:, 0] > 0)
        if met.any():
            shares[at] = float((distance[near][met] < enter[met, 1] - BEFORE_M).mean())
    return shares, inside


STILL_M = 1.0
"""Distance, metres, from their median within which nine in ten boxes of an actor that stands still lie. In a recorded
drive of Argoverse 2 the boxes of parked vehicles wander by up to 0.9 m as the LiDAR sees more of them, and those of
moving ones by 2.7 m and more."""
STILL_DEFORMING_M = 0.5
"""`STILL_M` of people: those who stand wander by up to 0.5 m, those who walk by 2.4 m and more."""
HALF_FRAME_S = 0.05
"""Half a frame, seconds: an actor is present from that before its first box to that after its last."""
CLOSEST_KEYS_S = 0.03
"""Smallest time, seconds, between two keys: an object at a sweep's seam is passed twice, and the second box is left
out."""


def passing_times(lidar: Lidar, positions: FloatArray, frame_times_s: FloatArray) -> FloatArray:
    """Return the times (T,), seconds, at which the beams of the sweep at each frame's time (T,) pass points (T, 3),
    world frame."""
    model = lidar.model
    turned = 0.0 if lidar.phase is None else np.interp(frame_times_s, lidar.phase.times_s, lidar.phase.turned_rad)
    times = frame_times_s + model.time_offset_s - model.sweep_s / 2
    for _ in range(2):  # where the LiDAR is depends on the time, by less than a turn's hundredth
        lidar_from_world = invert_pose(lidar.world_from_lidar.at(times))
        local = np.einsum("tij,tj->ti", lidar_from_world[:, :3, :3], positions) + lidar_from_world[:, :3, 3]
        azimuth = np.arctan2(local[:, 1], local[:, 0]) - model.start_azimuth_rad - turned
        turn = model.direction * azimuth / (2 * np.pi) % 1
        times = frame_times_s + model.time_offset_s + model.sweep_s * (turn - 1)
    return np.asarray(times)


@dataclass(frozen=True)
class TrackedBoxes:
    """Boxes, N of them, in the order of their frames: uid, label (N,) texts, frame_time_s (N,), poses (N, 4, 4), world
    frame, size_m (N, 3), and key_s (N,), the time at which each box was there. ``score`` (N,), of a detector or tracker;
    a box of no track has the uid ""."""

    uid: NDArray[Any]
    label: NDArray[Any]
    frame_time_s: FloatArray
    poses: FloatArray
    size_m: FloatArray
    key_s: FloatArray
    score: FloatArray | None = None


def actors_of_boxes(path: Path, boxes: TrackedBoxes) -> dict[str, Actor]:
    """Return actors by uid. Raises `LogError` naming the file for two boxes of one actor in a frame, and keys that are
    no trajectory."""
    if not len(boxes.uid):  # np.split of nothing gives one part
        return {}
    uids, group = np.unique(boxes.uid.astype(str), return_inverse=True)
    order = np.argsort(group, kind="stable")
    quaternions = quaternion_from_matrix(boxes.poses[:, :3, :3])
    actors = {}
    for uid, rows in zip(uids.tolist(), np.split(order, np.cumsum(np.bincount(group))[:-1]), strict=True):
        again = np.flatnonzero(np.diff(boxes.frame_time_s[rows]) <= 0)
        if len(again):
            raise LogError(f"{path}: box {uid} stands twice in the frame at {boxes.frame_time_s[rows[again[0]]]} s")
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                actors[uid] = _actor(uid, boxes, rows, quaternions[rows])
        except TrajectoryError as error:
            raise LogError(f"{path}: the trajectory of box {uid}: {error}") from error
    return actors


def _actor(uid: str, boxes: TrackedBoxes, rows: NDArray[np.int64], quaternions: FloatArray) -> Actor:
    """Return an actor of boxes ``rows``."""
    frame_times, times = boxes.frame_time_s[rows], boxes.key_s[rows]
    start_s, end_s = min(times[0], frame_times[0]), max(times[-1], frame_times[-1])
    present_s = float(start_s) - HALF_FRAME_S, float(end_s) + HALF_FRAME_S
    size_m = np.median(boxes.size_m[rows], 0)
    return actor_of_boxes(
        uid, str(boxes.label[rows[0]]), size_m, times, boxes.poses[rows, :3, 3], quaternions, present_s
    )


def actor_of_boxes(
    uid: str, label: str, size_m: FloatArray, times_s: FloatArray, positions: FloatArray, quaternions: FloatArray,
    present_s: tuple[float, float],
) -> Actor:  # fmt: skip
    """Return an actor of boxes at times (T,), present from and to ``present_s``. One that stands still is put at the
    median of positions (T, 3), with the mean rotation of those that agree with the box nearest to it."""
    middle = np.median(positions, 0)
    strayed = np.linalg.norm(positions - middle, axis=1)
    motion = motion_of(label)
    limit = STILL_DEFORMING_M if motion == "deforming" else STILL_M
    is_moving = motion != "still" and float(np.quantile(strayed, 0.9)) > limit
    if is_moving:
        keys = spread_keys(times_s)
        path = Trajectory(times_s[keys], positions[keys], quaternions[keys])
    else:
        path = Trajectory(times_s[:1], middle[None], _mean_quaternion(quaternions, int(strayed.argmin()))[None])
    return Actor(uid, label, size_m, path, *present_s, is_moving, Appearance(uid))


def spread_keys(times_s: FloatArray) -> list[int]:
    """Return which keys to keep of times (T,): each at least `CLOSEST_KEYS_S` after the one before."""
    keys = [0]
    for key in range(1, len(times_s)):
        if times_s[key] - times_s[keys[-1]] >= CLOSEST_KEYS_S:
            keys.append(key)
    return keys


def _mean_quaternion(quaternions: FloatArray, about: int) -> FloatArray:
    """Return the mean (4,) of quaternions (T, 4) within 30 degrees of the one numbered ``about``: a box may be reversed
    in some frames."""
    reference = quaternions[about]
    dots = quaternions @ reference
    near = np.abs(dots) > np.cos(np.radians(15.0))
    mean = (np.sign(dots[near])[:, None] * quaternions[near]).mean(0)
    return np.asarray(mean / np.linalg.norm(mean))
