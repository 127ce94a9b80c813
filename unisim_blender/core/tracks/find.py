"""All stages: from a log's sweeps to tracks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..data.log import Log
from ..geometry import UNIT_BOX_CORNERS, FloatArray, Trajectory, invert_pose, transform_points
from ..world.drive import Actor, Appearance, Drive
from .associate import associate
from .box_file import Track, common_times, moved
from .boxes import closest_heading
from .certainty import moving_features, probability
from .clusters import Cluster, together
from .evidence import Evidence, SearchProgress, evidence_of, tell
from .ground import GroundHeights
from .register import PlanarPath, register, returns_of, rotated, smoothed
from .shape import VEHICLES, shape_of, supported
from .standing import CONE_CERTAINTY, StandingBox, around, standing_box

MOVED_M = 1.5
"""What moves gets this far from where it began."""
MOVED = 0.4
"""A vehicle gets this part of its length away."""
NOISE_M = 0.5
LEAST_CERTAINTY = 0.05
SOURCE = "lidar"
SURE = 0.5
BESIDE_M = 15.0
"""Traffic this near tells which way a standing vehicle looks."""
RISE_M = 0.12
"""A vehicle's rear is this much higher than its front, where that tells them apart."""


@dataclass(frozen=True)
class Candidate:
    """A track, and what sweeps show of it: `certainty.FEATURES`, none of a cone."""

    track: Track
    features: tuple[float, ...]


def find_tracks(log: Log, progress: SearchProgress = lambda stage, done: None) -> tuple[Track, ...]:
    """Return the tracks of a log's sweeps, what moves before what stands, each in order of their first times.

    Raises `LogError` where no LiDAR has two sweeps, scipy is not installed, or a sweep cannot be read.
    """
    tracks = [candidate.track for candidate in candidates(log, progress)]
    return tuple(without_doubles([track for track in tracks if track.certainty >= LEAST_CERTAINTY]))


def candidates(log: Log, progress: SearchProgress = lambda stage, done: None) -> list[Candidate]:
    """Return all that may be tracks, as `find_tracks`, however uncertain, and where several lie in one place."""
    evidence = evidence_of(log, progress)
    ground = evidence.ground
    chains, stays = associate(evidence.clusters), evidence.stays.voxels(ground)
    moving = []
    for number, chain in enumerate(chains):
        if (found := _moving(f"{number:03d}", chain, evidence, stays)) is not None:
            moving.append(found)
        tell("registration", (number + 1) / len(chains), progress)
    boxes = [box for part in evidence.stays.parts(ground) if (box := standing_box(part)) is not None]
    sure = [candidate.track.actor.world_from_actor for candidate in moving if candidate.track.certainty > SURE]
    ways = _ways([log.drive.world_from_ego, *sure])
    standing = [_standing(f"{number:03d}", box, ground, ways, stays) for number, box in enumerate(boxes)]
    tell("standing", 1.0, progress)
    return [*moving, *standing]


def _moving(uid: str, clusters: Sequence[Cluster], evidence: Evidence, stays: FloatArray) -> Candidate | None:
    """Return the track of clusters of one thing; None of one that does not move. ``stays``: `StandingMap.voxels`."""
    ground, times_s = evidence.ground, evidence.times_s
    seen = len(clusters)
    clusters = together(clusters)
    times = np.array([cluster.middle_s for cluster in clusters])
    middles = np.array([cluster.middle for cluster in clusters])
    largest = max(clusters, key=lambda cluster: len(cluster.points))
    path = smoothed(times, middles, np.full(len(times), closest_heading(largest.points[:, :2])), NOISE_M)
    if _moved(path) < MOVED_M:
        return None
    returns = returns_of(clusters, ground.height)
    origins = np.array([cluster.origin[:2] for cluster in clusters])
    length, shape = 0.0, None
    for _ in range(2):
        path = register(returns, path, length)
        local = returns.in_actor(path)
        good = supported(local, returns.sweep)
        if good.mean() < 0.5:
            good[:] = True
        at = returns.sweep[good]
        views = rotated(-path.yaw_rad[at], origins[at] - path.positions[at])
        shape = shape_of(local[good], views, float(np.quantile(path.speed, 0.9)))
        path = path.shifted(shape.middle)
        length = shape.size_m[0] if shape.label in VEHICLES else 0.0
    assert shape is not None
    if _moved(path) < max(MOVED_M, MOVED * length):
        return None
    fill = seen / max(int(((times_s > times[0] - 0.1) & (times_s < times[-1] + 0.1)).sum()), 1)
    features = moving_features(returns, fill, shape.seen, stays)
    actor = actor_of(uid, shape.label, shape.size_m, path, ground, True)
    count = sum(len(cluster.points) for cluster in clusters)
    return Candidate(Track(actor, probability(features, "moving"), SOURCE, count, len(times)), features)


def _moved(path: PlanarPath) -> float:
    return float(np.linalg.norm(path.positions - path.positions[0], axis=1).max())


def _ways(paths: Sequence[Trajectory]) -> FloatArray:
    """Return places and directions (N, 4) along the ways of what moves."""
    rows = [np.zeros((0, 4))]
    for path in paths:
        steps = np.diff(path.positions[:, :2], axis=0)
        length = np.linalg.norm(steps, axis=1)
        moves = length > 0.02
        rows.append(np.concatenate([path.positions[:-1, :2][moves], steps[moves] / length[moves, None]], 1))
    return np.concatenate(rows)


def _heading(box: StandingBox, ways: FloatArray) -> float:
    """Return a box's heading: its lower end is its front; where neither is lower, it looks where traffic beside it goes. Of
    an end alone, traffic tells along which axis it is, too."""
    yaw = box.yaw_rad
    away = np.linalg.norm(ways[:, :2] - box.middle, axis=1)
    beside = ways[away.argmin(), 2:] if len(away) and away.min() < BESIDE_M else None
    if box.is_end and beside is not None and abs(beside @ (np.cos(yaw), np.sin(yaw))) < np.sqrt(0.5):
        yaw += np.pi / 2
    elif abs(box.rise_m) > RISE_M:
        return yaw if box.rise_m > 0 else yaw + np.pi
    return yaw + np.pi if beside is not None and beside @ (np.cos(yaw), np.sin(yaw)) < 0 else yaw


def _standing(uid: str, box: StandingBox, ground: GroundHeights, ways: FloatArray, stays: FloatArray) -> Candidate:
    path = PlanarPath(np.array([box.first_s]), box.middle[None], np.array([_heading(box, ways)]))
    actor = replace(actor_of(f"standing-{uid}", box.label, box.size_m, path, ground, False), end_s=box.last_s)
    features = (*box.features, around(box, stays)) if box.features else ()
    certainty = probability(features, "standing") if features else CONE_CERTAINTY
    return Candidate(Track(actor, certainty, SOURCE, box.returns, box.sweeps), features)


def without_doubles(tracks: Sequence[Track]) -> list[Track]:
    """Return tracks without those that for most of their time lie in the place of a surer one, or of one with more
    returns: a mirror that is a cluster of its own."""
    chosen: list[Track] = []
    for track in sorted(tracks, key=lambda track: (track.certainty < SURE, -track.returns, track.actor.uid)):
        if not any(_covers(other.actor, track.actor) for other in chosen):
            chosen.append(track)
    order = {id(track): number for number, track in enumerate(tracks)}
    return sorted(chosen, key=lambda track: order[id(track)])


def _covers(larger: Actor, smaller: Actor) -> bool:
    """Return whether ``smaller`` is near ``larger`` for most of its time, and its middle or a good part of it inside."""
    times = common_times(larger, smaller, (smaller.end_s - smaller.start_s) / 2)
    if not len(times):
        return False
    poses, others = larger.world_from_actor.at(times), smaller.world_from_actor.at(times)
    corners = transform_points(others, UNIT_BOX_CORNERS * smaller.size_m * 0.8)
    inside = np.abs(transform_points(invert_pose(poses), corners)[..., :2]) < larger.size_m[:2] / 2
    grid = inside.all(-1).mean()
    middle = np.abs(transform_points(invert_pose(poses), others[:, None, :3, 3])[..., :2]) < larger.size_m[:2] / 2
    return bool(grid > 0.25 or middle.all(-1).mean() > 0.5)


def actor_of(
    uid: str, label: str, size_m: FloatArray, path: PlanarPath, ground: GroundHeights, is_moving: bool
) -> Actor:
    """Return the actor on a path, which stands on the ground."""
    track = path.trajectory(ground.height(path.positions) + size_m[2] / 2)
    uid = f"{label.lower()}-{uid}"
    return Actor(uid, label, size_m, track, float(path.times_s[0]), float(path.times_s[-1]), is_moving, Appearance(uid))


def in_own_world(tracks: Sequence[Track], used: Drive, own: Drive) -> tuple[Track, ...]:
    """Return tracks that were found in a log with other poses in the world of its own ones: ``own`` is the log's drive,
    ``used`` the drive with the poses that it was searched with."""
    if used is own:
        return tuple(tracks)
    return moved(tracks, lambda times: own.world_from_ego.at(times) @ invert_pose(used.world_from_ego.at(times)))
