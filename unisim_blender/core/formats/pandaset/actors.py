"""PandaSet's cuboids to actors: one tracklet for each uuid, twins of the second LiDAR dropped.

A cuboid was drawn around the points of its sweep, so a moving object was there when the beams passed it, up to 0.1 s
before the sweep's timestamp. On sequence 002, 84 % of moving cars' returns lie in boxes keyed so, 66 % in boxes keyed
at the timestamp.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...data.values import check_angles
from ...errors import LogError, in_a_line
from ...geometry import FloatArray, Trajectory, TrajectoryError, quaternion_from_yaw
from ...world.box_tracks import HALF_FRAME_S, passing_times, spread_keys
from ...world.drive import Actor, Appearance, Lidar
from .safe_pickle import read_table

_POSITION = ("position.x", "position.y", "position.z")
_SIZE = ("dimensions.y", "dimensions.x", "dimensions.z")
"""PandaSet's y is the length, x the width; a box of ours is length, width, height."""
_COLUMNS = ("uuid", "label", "yaw", "stationary", *_POSITION, *_SIZE)

STILL_M, STILL_RAD = 0.3, 0.1
"""An actor flagged as stationary that strays no further is taken to stand still at its median pose."""
JITTER_M, JITTER_RAD = 0.02, 0.01
"""The same for one that is not so flagged."""


@dataclass
class _Track:
    """One uuid's cuboids: their rows among all frames', in the order of frames."""

    label: str
    rows: list[int] = field(default_factory=list)


@dataclass(frozen=True)
class _Cuboids:
    """Cuboids of one frame, or of all: frame_times_s, yaws (N,), positions, sizes (N, 3), stationary (N,)."""

    frame_times_s: FloatArray
    positions: FloatArray
    yaws: FloatArray
    sizes: FloatArray
    stationary: NDArray[np.bool_]


def read_actors(
    files: Mapping[int, Path], time_s: Mapping[int, float], origin: FloatArray, lidar: Lidar | None
) -> dict[str, Actor]:
    """Actors by uuid from the cuboid files of frames; ``origin`` (3,) is subtracted from positions.

    A cuboid is keyed at the time when the beams of ``lidar`` pass its centre, or at the frame's where that is None.
    """
    tracks: dict[str, _Track] = {}
    frames: list[_Cuboids] = []
    count = 0
    for frame in sorted(files):
        frames.append(_read_frame(tracks, count, files[frame], time_s[frame], origin))
        count += len(frames[-1].yaws)
    if not count:
        return {}
    every = _Cuboids(
        *(np.concatenate([getattr(cuboids, part.name) for cuboids in frames]) for part in fields(_Cuboids))
    )
    actors = {}
    with np.errstate(over="ignore", invalid="ignore"):
        times = every.frame_times_s if lidar is None else passing_times(lidar, every.positions, every.frame_times_s)
        for uid, track in sorted(tracks.items()):
            try:
                actors[uid] = _actor(uid, track, every, times)
            except TrajectoryError as error:
                raise LogError(f"{files[min(files)].parent}: the trajectory of cuboid {uid}: {error}") from error
    return actors


def _read_frame(tracks: dict[str, _Track], before: int, path: Path, time_s: float, origin: FloatArray) -> _Cuboids:
    """A frame's cuboids without twins, each noted in its track; ``before`` are those of the frames before."""
    table = read_table(path, _COLUMNS)
    try:
        positions = np.stack([table[name].astype(np.float64) for name in _POSITION], -1)
        sizes = np.stack([table[name].astype(np.float64) for name in _SIZE], -1)
        yaws = table["yaw"].astype(np.float64)
        stationary = table["stationary"].astype(np.bool_)
        if "cuboids.sensor_id" in table:
            own = table["cuboids.sensor_id"].astype(np.int64) != 1
            positions, sizes, yaws, stationary = positions[own], sizes[own], yaws[own], stationary[own]
            table = {name: table[name][own] for name in ("uuid", "label")}
    except (TypeError, ValueError, OverflowError) as error:
        raise LogError(f"{path}: a cuboid's numbers are none ({in_a_line(error)})") from error
    uids = [str(uid) for uid in table["uuid"].tolist()]
    finite = np.isfinite(positions).all(1) & np.isfinite(sizes).all(1) & np.isfinite(yaws)
    if not finite.all():
        raise LogError(f"{path}: cuboid {uids[int(finite.argmin())]} holds a value that is not finite")
    solid = (sizes > 0).all(1)
    if not solid.all():
        row = int(solid.argmin())
        raise LogError(f"{path}: cuboid {uids[row]} has the size {tuple(float(size) for size in sizes[row])} m")
    check_angles(path, "a cuboid's yaw", yaws)
    if len(set(uids)) < len(uids):
        twice = next(uid for row, uid in enumerate(uids) if uid in uids[:row])
        raise LogError(f"{path}: cuboid {twice} stands there twice")
    for row, (uid, label) in enumerate(zip(uids, table["label"].tolist(), strict=True), before):
        if uid not in tracks:
            tracks[uid] = _Track(str(label))
        tracks[uid].rows.append(row)
    return _Cuboids(np.full(len(yaws), time_s), positions - origin, yaws, sizes, stationary)


def _actor(uid: str, track: _Track, cuboids: _Cuboids, times_s: FloatArray) -> Actor:
    """The actor of a track; ``times_s`` are when the beams passed each cuboid."""
    rows = np.array(track.rows)
    frame_times, positions, times = cuboids.frame_times_s[rows], cuboids.positions[rows], times_s[rows]
    yaws = np.unwrap(cuboids.yaws[rows]) + np.pi / 2  # yaw 0 is length along +y, ours along +x
    middle, middle_yaw = _median(positions), _median(yaws)
    strayed = float(np.linalg.norm(positions - middle, axis=1).max())
    turned = float(np.abs(yaws - middle_yaw).max())
    limit_m, limit_rad = (STILL_M, STILL_RAD) if cuboids.stationary[rows].all() else (JITTER_M, JITTER_RAD)
    is_moving = strayed > limit_m or turned > limit_rad
    start_s, end_s = min(times[0], frame_times[0]), max(times[-1], frame_times[-1])
    if is_moving:
        spread = spread_keys(times)
        times, positions, yaws = times[spread], positions[spread], yaws[spread]
    else:
        times, positions, yaws = times[:1], middle[None], middle_yaw[None]
    return Actor(
        uid=uid,
        label=track.label,
        size_m=_median(cuboids.sizes[rows]),
        world_from_actor=Trajectory(times, positions, quaternion_from_yaw(yaws)),
        start_s=float(start_s) - HALF_FRAME_S,
        end_s=float(end_s) + HALF_FRAME_S,
        is_moving=is_moving,
        appearance=Appearance(uid),
    )


def _median(values: FloatArray) -> FloatArray:
    """The median along the first axis, as numpy's, which takes ten times as long over a few finite numbers."""
    ordered, half = np.sort(values, 0), len(values) // 2
    return np.asarray(ordered[half] if len(values) % 2 else (ordered[half - 1] + ordered[half]) / 2)
