"""Detectors of other packages, and tracks of what a detector sees: by the association and smoothing of `find_tracks`.

Another distribution brings a detector by an entry point in its pyproject.toml:

    [project.entry-points."unisim_blender.detectors"]
    name = "module:detector"
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..data.log import Log
from ..errors import LogError, UnisimError, in_a_line
from ..geometry import (
    UNIT_BOX_CORNERS,
    FloatArray,
    Trajectory,
    invert_pose,
    make_pose,
    quaternion_from_matrix,
    quaternion_from_yaw,
    transform_points,
)
from ..registry import Registry
from ..world.box_tracks import CLOSEST_KEYS_S, HALF_FRAME_S, TrackedBoxes, actor_of_boxes, passing_times
from ..world.drive import Actor, Appearance
from .associate import associate
from .box_file import Track, common_times, unused_uid
from .clusters import Cluster
from .register import smoothed

LEAST_SCORE = 0.1
"""Detections of lower scores are left out."""
NOISE_M = 0.3
"""Standard deviation of a detection's centre, metres."""
HEIGHT_KEYS = 5
"""Number of keys whose mean is a moving box's height."""
SAME_PART, SAME_M = 0.35, 1.0
"""A found and a detected track are one where their middles are nearer than this part of the length, or this."""


@dataclass(frozen=True)
class SweepDetections:
    """What a detector sees in a sweep, M boxes: boxes (M, 7) x, y, z of the centre, length, width, height, yaw, in the
    frame of the points; label (M,) texts, score (M,) from 0 to 1."""

    boxes: FloatArray
    label: Sequence[str]
    score: FloatArray


class Detector(Protocol):
    """A detector of actors in single sweeps."""

    name: str
    """One word, unique among detectors: "centerpoint"."""
    about: str
    """What it is, in a few words."""

    def detect(self, points: NDArray[np.float32]) -> SweepDetections:
        """Return what a sweep shows. ``points`` (N, 4): x, y, z, metres, in the LiDAR's frame at the sweep's time (x forward,
        y left, z up), the vehicle's motion undone, and intensity from 0 to 1."""


DETECTORS: Registry[Detector] = Registry("a detector", "unisim_blender.detectors", ("name", "about", "detect"))
"""The detectors by their names; the package has none of its own."""


def detector_named(name: str) -> Detector:
    """Return an installed detector. Raises `UnisimError`."""
    known = DETECTORS.with_plugins()
    if name not in known:
        raise UnisimError(f"--detector {name}: is not installed; there is {', '.join(known) or 'none'}")
    return known[name]


def detected_boxes(
    log: Log, detector: Detector, progress: Callable[[float], object] = lambda done: None
) -> TrackedBoxes:
    """Return what a detector sees in every sweep of a log, in the world. Raises `LogError`."""
    lidars = log.drive.lidars
    refs = [(lidars[name].time_s[frame], name, frame) for name in lidars for frame in log.sweep_frames(name)]
    if not refs:
        raise LogError(f"{log.path}: has no sweep that {detector.name} could look at")
    parts = []
    for number, (time_s, name, frame) in enumerate(sorted(refs)):
        lidar, sweep = lidars[name], log.sweep(name, frame)
        pose = lidar.world_from_lidar.at(time_s)
        points = np.column_stack([transform_points(invert_pose(pose), sweep.points), sweep.intensity])
        seen = _checked(detector, points.astype(np.float32), f"{log.path}: {name}, frame {frame}")
        poses = pose @ make_pose(seen.boxes[:, :3], quaternion_from_yaw(seen.boxes[:, 6]))
        times = np.full(len(poses), time_s)
        keys = passing_times(lidar, poses[:, :3, 3], times) if lidar.model.beams and len(poses) else times
        label, none = np.array(seen.label, np.str_), np.full(len(poses), "")
        parts.append(TrackedBoxes(none, label, times, poses, seen.boxes[:, 3:6], keys, seen.score))
        progress((number + 1) / len(refs))
    columns = (np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(TrackedBoxes))
    return TrackedBoxes(*columns)


def _checked(detector: Detector, points: NDArray[np.float32], place: str) -> SweepDetections:
    """Return what a detector sees, as arrays of float64. Raises `LogError` for what it must not return or raise."""
    try:
        seen = detector.detect(points)
        boxes, score = np.asarray(seen.boxes, np.float64), np.asarray(seen.score, np.float64)
        if not len(boxes):
            return SweepDetections(np.zeros((0, 7)), (), np.zeros(0))
        if boxes.shape != (len(boxes), 7) or score.shape != (len(boxes),) or len(seen.label) != len(boxes):
            raise ValueError(f"{boxes.shape} boxes, {len(seen.label)} labels and {score.shape} scores")
        if not np.isfinite(boxes).all() or not (boxes[:, 3:6] > 0).all() or not ((score >= 0) & (score <= 1)).all():
            raise ValueError("a box that is not finite or has no size, or a score that is not from 0 to 1")
    except Exception as fault:  # noqa: BLE001  another package's code may raise anything
        raise LogError(f"{place}: the detector {detector.name}: {type(fault).__name__}: {in_a_line(fault)}") from fault
    return SweepDetections(boxes, [str(label) for label in seen.label], score)


@dataclass(frozen=True)
class BoxCluster(Cluster):
    """The corners of a detection as a cluster of `associate`; ``row`` is its number among the detections."""

    row: int = -1


def linked(boxes: TrackedBoxes, source: str) -> tuple[Track, ...]:
    """Return the tracks of detections, named by their class and number, in order of their begin; the mean of its
    detections' scores is a track's certainty."""
    score = np.ones(len(boxes.uid)) if boxes.score is None else boxes.score
    chains = associate([_cluster(boxes, row) for row in rows] for rows in _by_frame(boxes, score))
    tracks = []
    for number, chain in enumerate(chains):
        rows = np.array([cluster.row for cluster in chain if isinstance(cluster, BoxCluster)])
        if len(rows):
            tracks.append(_track(boxes, score, rows[np.argsort(boxes.key_s[rows], kind="stable")], number, source))
    return tuple(tracks)


def _by_frame(boxes: TrackedBoxes, score: FloatArray) -> Iterator[list[int]]:
    """Yield the detections of each frame, in order of time, without those in the place of one of a higher score."""
    chosen = np.flatnonzero(score >= LEAST_SCORE)
    order = chosen[np.lexsort((-score[chosen], boxes.frame_time_s[chosen]))]
    for rows in np.split(order, np.flatnonzero(np.diff(boxes.frame_time_s[order])) + 1):
        best: list[int] = []
        for row in rows.tolist():
            away = np.linalg.norm(boxes.poses[best, :2, 3] - boxes.poses[row, :2, 3], axis=1)
            if not (away < boxes.size_m[row, 1] / 2).any():
                best.append(row)
        yield best


def _cluster(boxes: TrackedBoxes, row: int) -> BoxCluster:
    corners = transform_points(boxes.poses[row], UNIT_BOX_CORNERS * boxes.size_m[row])
    return BoxCluster(corners, np.full(len(corners), boxes.key_s[row]), np.zeros(3), row=row)


def _track(boxes: TrackedBoxes, score: FloatArray, rows: NDArray[np.int64], number: int, source: str) -> Track:
    """Return the track of detections ``rows``, in order of time: standing, or smoothed."""
    rows = rows[np.append(True, np.diff(boxes.key_s[rows]) > CLOSEST_KEYS_S)]
    votes: dict[str, float] = defaultdict(float)
    for row in rows:
        votes[str(boxes.label[row])] += float(score[row])
    label = max(votes, key=votes.__getitem__)
    uid = f"{label.lower()}-{number:03d}"
    times, poses, certainty = boxes.key_s[rows], boxes.poses[rows], float(score[rows].mean())
    present_s = float(times[0]) - HALF_FRAME_S, float(times[-1]) + HALF_FRAME_S
    turns, size_m = quaternion_from_matrix(poses[:, :3, :3]), np.median(boxes.size_m[rows], 0)
    actor = actor_of_boxes(uid, label, size_m, times, poses[:, :3, 3], turns, present_s)
    if actor.is_moving:
        yaw = np.arctan2(poses[:, 1, 0], poses[:, 0, 0])
        path = smoothed(times, poses[:, :2, 3], yaw, NOISE_M)
        near = np.abs(np.arange(len(rows))[:, None] - np.arange(len(rows))) <= HEIGHT_KEYS // 2
        positions = np.column_stack([path.positions, near @ poses[:, 2, 3] / near.sum(1)])
        actor = replace(actor, world_from_actor=Trajectory(times, positions, quaternion_from_yaw(path.yaw_rad)))
    return Track(actor, certainty, source, 0, len(rows))


def fused(found: Sequence[Track], detected: Sequence[Track]) -> tuple[Track, ...]:
    """Return the tracks of both: where two are one, the found path, which sweeps were registered to, goes on as the
    detected one does, with this one's class, and is as certain as two that were right by chance alone."""
    left, tracks = list(detected), []
    for track in found:
        same = [other for other in left if _is_same(track.actor, other.actor)]
        if same:
            other = max(same, key=lambda other: other.actor.end_s - other.actor.start_s)
            left = [track for track in left if all(track is not twin for twin in same)]
            certainty = 1 - (1 - track.certainty) * (1 - other.certainty)
            source = " and ".join(filter(None, (track.source, other.source)))
            track = replace(track, actor=_continued(track.actor, other.actor), certainty=certainty, source=source)
        tracks.append(track)
    for other in left:
        uid = unused_uid(other.actor.uid, {track.actor.uid for track in tracks})
        tracks.append(replace(other, actor=replace(other.actor, uid=uid, appearance=Appearance(uid))))
    return tuple(tracks)


def _is_same(a: Actor, b: Actor) -> bool:
    """Return whether two actors are in one place while both are there, which is half of the shorter's time or more."""
    times = common_times(a, b, min(a.end_s - a.start_s, b.end_s - b.start_s) / 2)
    places = [actor.world_from_actor.positions_at(times)[:, :2] for actor in (a, b)]
    away = np.linalg.norm(places[0] - places[1], axis=1)
    return bool(len(times)) and float(np.median(away)) < max(SAME_M, SAME_PART * max(a.size_m[0], b.size_m[0]))


def _continued(own: Actor, other: Actor) -> Actor:
    """Return an actor of the class of another, and with its keys before and after its own, displaced as those at the
    ends are."""
    start, end = min(own.start_s, other.start_s), max(own.end_s, other.end_s)
    own = replace(own, label=other.label, start_s=start, end_s=end)
    path, more = own.world_from_actor, other.world_from_actor
    if not own.is_moving or len(more.times_s) == 1:
        return own
    before, after = more.times_s < path.times_s[0] - CLOSEST_KEYS_S, more.times_s > path.times_s[-1] + CLOSEST_KEYS_S
    ends = [invert_pose(more.at(path.times_s[at])) @ path.poses[at] for at in (0, -1)]
    poses = np.concatenate([more.poses[before] @ ends[0], path.poses, more.poses[after] @ ends[1]])
    times = np.concatenate([more.times_s[before], path.times_s, more.times_s[after]])
    return replace(own, world_from_actor=Trajectory.from_poses(times, poses))
