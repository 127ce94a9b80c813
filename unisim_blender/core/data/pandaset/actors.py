"""PandaSet's cuboids to actors: one tracklet for each uuid, twins of the second LiDAR dropped.

A cuboid was drawn around the points of its sweep, so a moving object was there when the beams passed it, up to 0.1 s
before the sweep's timestamp. On sequence 002, 84 % of moving cars' returns lie in boxes keyed so, 66 % in boxes keyed
at the timestamp.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...errors import LogError, in_a_line
from ...geometry import FloatArray, Trajectory, TrajectoryError, quaternion_from_yaw
from ...world.drive import Actor, Appearance, Lidar
from ..box_tracks import HALF_FRAME_S, passing_times, spread_keys
from ..safe_pickle import read_table

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
    """One uuid's cuboids in the order of frames, the last frame's time among them."""

    label: str
    frame_times_s: list[float] = field(default_factory=list)
    positions: list[FloatArray] = field(default_factory=list)
    yaws: list[float] = field(default_factory=list)
    sizes: list[FloatArray] = field(default_factory=list)
    stationary: list[bool] = field(default_factory=list)


def read_actors(
    files: Mapping[int, Path], time_s: Mapping[int, float], origin: FloatArray, lidar: Lidar | None
) -> dict[str, Actor]:
    """Actors by uuid from the cuboid files of frames; ``origin`` (3,) is subtracted from positions.

    A cuboid is keyed at the time when the beams of ``lidar`` pass its centre, or at the frame's where that is None.
    """
    tracks: dict[str, _Track] = {}
    for frame in sorted(files):
        _add_frame(tracks, files[frame], time_s[frame], origin)
    actors = {}
    for uid, track in sorted(tracks.items()):
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                actors[uid] = _actor(uid, track, lidar)
        except TrajectoryError as error:
            raise LogError(f"{files[min(files)].parent}: the trajectory of cuboid {uid}: {error}") from error
    return actors


def _add_frame(tracks: dict[str, _Track], path: Path, time_s: float, origin: FloatArray) -> None:
    table = read_table(path, _COLUMNS)
    try:
        positions = np.stack([table[name].astype(np.float64) for name in _POSITION], -1)
        sizes = np.stack([table[name].astype(np.float64) for name in _SIZE], -1)
        yaws = table["yaw"].astype(np.float64)
        twin = (
            table["cuboids.sensor_id"].astype(np.int64) == 1
            if "cuboids.sensor_id" in table
            else np.zeros(len(yaws), bool)
        )
    except (TypeError, ValueError, OverflowError) as error:
        raise LogError(f"{path}: a cuboid's numbers are none ({in_a_line(error)})") from error
    for row in np.flatnonzero(~twin):
        uid = str(table["uuid"][row])
        if not (np.isfinite(positions[row]).all() and np.isfinite(sizes[row]).all() and np.isfinite(yaws[row])):
            raise LogError(f"{path}: cuboid {uid} holds a value that is not finite")
        if (sizes[row] <= 0).any():
            raise LogError(f"{path}: cuboid {uid} has the size {tuple(float(size) for size in sizes[row])} m")
        track = tracks.setdefault(uid, _Track(str(table["label"][row])))
        if track.frame_times_s and track.frame_times_s[-1] >= time_s:
            raise LogError(f"{path}: cuboid {uid} stands there twice")
        track.frame_times_s.append(time_s)
        track.positions.append(positions[row] - origin)
        track.yaws.append(float(yaws[row]))
        track.sizes.append(sizes[row])
        track.stationary.append(bool(table["stationary"][row]))


def _actor(uid: str, track: _Track, lidar: Lidar | None) -> Actor:
    frame_times, positions = np.array(track.frame_times_s), np.stack(track.positions)
    times = frame_times if lidar is None else passing_times(lidar, positions, frame_times)
    yaws = np.unwrap(np.array(track.yaws)) + np.pi / 2  # yaw 0 is length along +y, ours along +x
    strayed = float(np.linalg.norm(positions - np.median(positions, 0), axis=1).max())
    turned = float(np.abs(yaws - np.median(yaws)).max())
    limit_m, limit_rad = (STILL_M, STILL_RAD) if all(track.stationary) else (JITTER_M, JITTER_RAD)
    is_moving = strayed > limit_m or turned > limit_rad
    start_s, end_s = min(times[0], frame_times[0]), max(times[-1], frame_times[-1])
    if is_moving:
        spread = spread_keys(times)
        times, positions, yaws = times[spread], positions[spread], yaws[spread]
    else:
        times, positions, yaws = times[:1], np.median(positions, 0, keepdims=True), np.median(yaws, keepdims=True)
    return Actor(
        uid=uid,
        label=track.label,
        size_m=np.median(np.stack(track.sizes), 0),
        world_from_actor=Trajectory(times, positions, quaternion_from_yaw(yaws)),
        start_s=float(start_s) - HALF_FRAME_S,
        end_s=float(end_s) + HALF_FRAME_S,
        is_moving=is_moving,
        appearance=Appearance(uid),
    )
