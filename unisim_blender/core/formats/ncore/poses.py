"""NCore's pose graph and trajectories. An edge (a, b) maps points of frame a to b; it stands still or has poses over time.

A sensor that rides on the vehicle has a still edge to "rig", which moves in "world". ("world", "world_global") is still.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ...geometry import (
    STEADY_M,
    STEADY_RAD,
    FloatArray,
    Trajectory,
    TrajectoryError,
    invert_pose,
    mean_pose,
    quaternion_from_matrix,
)
from ...json_file import ROTATION_TOLERANCE

RIG, WORLD, GLOBAL = "rig", "world", "world_global"
OWN = "unisim:"
"""Before a sensor's name: the frame with its own poses over time, where its name has the mean of them on the vehicle."""
CHORD_M = 1e-4
"""A sensor on a turning vehicle moves along arcs; keys are added until their chords are this near to them."""
MOST_PARTS = 64
"""Into which the way between two poses is cut for that at most."""
RIDING = 1e-6
"""A sensor whose pose on the vehicle changes by less, in metres and in its axes, rides on it."""


@dataclass(frozen=True)
class Edge:
    """``pose`` (4, 4) of an edge that stands still, or its ``track``, over the drive's seconds."""

    pose: FloatArray
    track: Trajectory | None = None


class PoseGraph:
    """Frames and the edges between them; ``place`` is the file's name, for messages."""

    def __init__(self, edges: Mapping[tuple[str, str], Edge], place: str) -> None:
        self.place = place
        self._edges = dict(edges)
        self._beside: dict[str, list[str]] = {}
        for source, target in edges:
            self._beside.setdefault(source, []).append(target)
            self._beside.setdefault(target, []).append(source)

    def __contains__(self, frame: str) -> bool:
        return frame in self._beside

    def still(self, source: str, target: str) -> FloatArray | None:
        """Return the pose (4, 4) of ``source`` in ``target`` where no edge between them moves; None otherwise."""
        steps = self._path(self._own(source), target)
        if steps is None or any(edge.track is not None for edge, _ in steps):
            return None
        pose = np.eye(4)
        for edge, forward in steps:
            pose = (edge.pose if forward else invert_pose(edge.pose)) @ pose
        return pose

    def track(self, source: str, target: str, arcs: bool) -> Trajectory:
        """Return the trajectory of ``source`` in ``target``. ``arcs``: keys are added between those that edges have, see CHORD_M.
        Raises `LogError` where they are not connected."""
        steps = self._path(self._own(source), target)
        if steps is None:
            raise LogError(f"{self.place}: no poses lead from {source!r} to {target!r}")
        tracks = [edge.track for edge, _ in steps if edge.track is not None]
        if not tracks:
            pose = self.still(source, target)
            assert pose is not None
            return Trajectory.from_poses(np.zeros(1), pose[None])
        times = np.unique(np.concatenate([track.times_s for track in tracks]))
        first, last = max(track.times_s[0] for track in tracks), min(track.times_s[-1] for track in tracks)
        times = times[(times >= first) & (times <= last)]
        if not len(times):
            raise LogError(f"{self.place}: the poses from {source!r} to {target!r} share no time")
        if len(steps) == 1 and steps[0][1]:
            return tracks[0]
        if arcs:
            times = _with_arcs(steps, tracks, times)
        return Trajectory.from_poses(times, _evaluated(steps, times))

    def _own(self, frame: str) -> str:
        return OWN + frame if OWN + frame in self._beside else frame

    def _path(self, source: str, target: str) -> list[tuple[Edge, bool]] | None:
        """The edges from ``source`` to ``target``, and whether each is gone along forwards."""
        if source not in self._beside:
            return None
        came: dict[str, str] = {source: source}
        queue = [source]
        for frame in queue:
            for other in self._beside[frame]:
                if other not in came:
                    came[other] = frame
                    queue.append(other)
        if target not in came:
            return None
        steps: list[tuple[Edge, bool]] = []
        while target != source:
            before = came[target]
            forward = (before, target) in self._edges
            steps.append((self._edges[(before, target) if forward else (target, before)], forward))
            target = before
        return steps[::-1]


def read_graph(
    static: Any, dynamic: Any, epoch_us: int, place: str, added: Mapping[str, tuple[bool, bool]]
) -> PoseGraph:
    """Return the graph of NCore's pairs of edges and poses, and of poses and times in microseconds. ``added``: the frames whose
    first or last pose carries on what the others say, and is left out. Raises `LogError`."""
    edges: dict[tuple[str, str], Edge] = {}
    for names, pose in static:
        edges[_pair(names, place)] = Edge(_rigid(np.asarray(pose, np.float64)[None], f"{place}: the pose {names}")[0])
    for names, (poses, times_us) in dynamic:
        what = f"{place}: the poses {names}"
        matrices = _rigid(np.asarray(poses, np.float64), what)
        seconds = (np.asarray(times_us).astype(np.int64) - epoch_us) / 1e6
        first, last = added.get(_pair(names, place)[0], (False, False))
        inner = slice(int(first), len(seconds) - int(last))
        try:
            track = Trajectory(seconds, matrices[:, :3, 3], quaternion_from_matrix(matrices[:, :3, :3]))
            track = Trajectory(track.times_s[inner], track.positions[inner], track.quaternions_wxyz[inner])
        except TrajectoryError as fault:
            raise LogError(f"{what}: {fault}") from fault
        edges[_pair(names, place)] = Edge(matrices[0], track)
    return PoseGraph(edges, place)


@dataclass(frozen=True)
class Mount:
    """Where a sensor sits on the vehicle, ``pose`` (4, 4), and how far it moves beside that, metres and radians."""

    pose: FloatArray
    off_m: float = 0.0
    off_rad: float = 0.0


def mount_of(sensor: Trajectory, ego: Trajectory, start_s: float, end_s: float, captured_s: FloatArray) -> Mount | None:
    """Return where a sensor sits on the vehicle; None where it does not ride on it.

    It rides on it by all poses of a span of time, or nearly so when it captures, at times (T,): it sits at the mean over these.
    """
    times = np.unique(np.concatenate([sensor.times_s, ego.times_s, [start_s, end_s]]))
    times = times[(times >= start_s) & (times <= end_s)]
    nearest = times[np.abs(times - ego.times_s[0]).argmin()]
    mount = invert_pose(ego.at(nearest)) @ sensor.at(nearest)
    ridden = ego.transformed(right=mount) if len(ego.times_s) > 1 else None
    there = ego.at(times) @ mount if ridden is None else ridden.at(times)
    if np.abs(there - sensor.at(times)).max() < RIDING:
        return Mount(mount)
    if not len(captured_s):
        return None
    mean = Mount(*mean_pose(invert_pose(ego.at(captured_s)) @ sensor.at(captured_s)))
    return mean if mean.off_m <= STEADY_M and mean.off_rad <= STEADY_RAD else None


def sampled(
    track: Trajectory, start_us: int, end_us: int, epoch_us: int
) -> tuple[FloatArray, NDArray[np.uint64], tuple[bool, bool]]:
    """Return poses (K, 4, 4) and times (K,), whole microseconds, of a trajectory, at its keys between two times and at these; and
    whether the first and the last carry on what the others say.

    Poses are those at the rounded times, so that between keys the drive's own are met but for the half microsecond at a bend.
    """
    keys = np.rint(track.times_s * 1e6).astype(np.int64) + epoch_us
    times = np.unique(np.concatenate([keys[(keys > start_us) & (keys < end_us)], [start_us, end_us]]))
    added = bool(start_us < keys[0] < end_us), bool(start_us < keys[-1] < end_us)
    return track.at((times - epoch_us) / 1e6), times.astype(np.uint64), added


def _evaluated(steps: list[tuple[Edge, bool]], times: FloatArray) -> FloatArray:
    poses = np.broadcast_to(np.eye(4), (len(times), 4, 4))
    for edge, forward in steps:
        step = edge.pose if edge.track is None else edge.track.at(times)
        poses = (step if forward else invert_pose(step)) @ poses
    return poses


def _with_arcs(steps: list[tuple[Edge, bool]], tracks: list[Trajectory], times: FloatArray) -> FloatArray:
    """Times and more between them, where the way in the middle lies beside that between the ends."""
    if len(times) < 2:
        return times
    ends, middles = _evaluated(steps, times)[:, :3, 3], _evaluated(steps, (times[1:] + times[:-1]) / 2)[:, :3, 3]
    beside = np.linalg.norm(middles - (ends[1:] + ends[:-1]) / 2, axis=1)
    parts = np.clip(np.ceil(np.sqrt(beside / CHORD_M)), 1, MOST_PARTS).astype(np.int64)
    begins = np.repeat(times[:-1], parts)
    number = np.arange(parts.sum()) - np.repeat(np.cumsum(parts) - parts, parts)
    return np.append(begins + number / np.repeat(parts, parts) * np.repeat(np.diff(times), parts), times[-1])


def _pair(names: object, place: str) -> tuple[str, str]:
    if not isinstance(names, tuple) or len(names) != 2 or not all(isinstance(name, str) for name in names):
        raise LogError(f"{place}: a pose is of {names!r:.80}, not from one frame to another")
    return names[0], names[1]


def _rigid(poses: FloatArray, what: str) -> FloatArray:
    if poses.ndim != 3 or poses.shape[1:] != (4, 4) or not np.isfinite(poses).all():
        raise LogError(f"{what}: is no pose of 4 x 4 finite numbers")
    axes = poses[:, :3, :3]
    off = np.abs(axes @ axes.swapaxes(1, 2) - np.eye(3)).max(initial=0.0)
    if (
        off > ROTATION_TOLERANCE
        or (np.linalg.det(axes) < 0).any()
        or (np.abs(poses[:, 3] - (0, 0, 0, 1)) > ROTATION_TOLERANCE).any()
    ):
        raise LogError(f"{what}: is not rigid")
    return poses
