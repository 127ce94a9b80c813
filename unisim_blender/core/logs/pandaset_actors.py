"""PandaSet's cuboids to actors: one tracklet for each uuid, twins of the second LiDAR dropped."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..drive import Actor, Look
from ..errors import LogError
from ..geometry import FloatArray, Trajectory, quaternion_from_yaw
from .safe_pickle import read_table

_POSITION = ("position.x", "position.y", "position.z")
_SIZE = ("dimensions.y", "dimensions.x", "dimensions.z")
"""PandaSet's y is the length, x the width; a box of ours is length, width, height."""
_COLUMNS = ("uuid", "label", "yaw", "stationary", *_POSITION, *_SIZE)

STILL_M, STILL_RAD = 0.3, 0.1
"""An actor flagged as stationary that strays no further is taken to stand still at its median pose."""
JITTER_M, JITTER_RAD = 0.02, 0.01
"""The same for one that is not so flagged."""
HALF_FRAME_S = 0.05
"""An actor is there from half a frame before its first cuboid to half a frame after its last."""


@dataclass
class _Track:
    """One uuid's cuboids in the order of frames."""

    path: Path
    label: str
    times_s: list[float] = field(default_factory=list)
    positions: list[FloatArray] = field(default_factory=list)
    yaws: list[float] = field(default_factory=list)
    sizes: list[FloatArray] = field(default_factory=list)
    stationary: list[bool] = field(default_factory=list)


def read_actors(files: Mapping[int, Path], time_s: Mapping[int, float], origin: FloatArray) -> dict[str, Actor]:
    """Actors by uuid from the cuboid files of frames; ``origin`` (3,) is subtracted from positions."""
    tracks: dict[str, _Track] = {}
    for frame in sorted(files):
        _add_frame(tracks, files[frame], time_s[frame], origin)
    return {uid: _actor(uid, track) for uid, track in sorted(tracks.items())}


def _add_frame(tracks: dict[str, _Track], path: Path, time_s: float, origin: FloatArray) -> None:
    table = read_table(path, _COLUMNS)
    try:
        positions = np.stack([table[name].astype(np.float64) for name in _POSITION], -1)
        sizes = np.stack([table[name].astype(np.float64) for name in _SIZE], -1)
        yaws = table["yaw"].astype(np.float64)
        twin = table["cuboids.sensor_id"].astype(np.int64) == 1 if "cuboids.sensor_id" in table else np.zeros(len(yaws), bool)
    except (TypeError, ValueError) as error:
        raise LogError(f"{path}: a cuboid's numbers are none ({error})") from error
    for row in np.flatnonzero(~twin):
        uid = str(table["uuid"][row])
        if not (np.isfinite(positions[row]).all() and np.isfinite(sizes[row]).all() and np.isfinite(yaws[row])):
            raise LogError(f"{path}: cuboid {uid} holds a value that is not finite")
        if (sizes[row] <= 0).any():
            raise LogError(f"{path}: cuboid {uid} has the size {tuple(float(size) for size in sizes[row])} m")
        track = tracks.setdefault(uid, _Track(path, str(table["label"][row])))
        if track.times_s and track.times_s[-1] >= time_s:
            raise LogError(f"{path}: cuboid {uid} stands there twice")
        track.times_s.append(time_s)
        track.positions.append(positions[row] - origin)
        track.yaws.append(float(yaws[row]))
        track.sizes.append(sizes[row])
        track.stationary.append(bool(table["stationary"][row]))


def _actor(uid: str, track: _Track) -> Actor:
    times, positions = np.array(track.times_s), np.stack(track.positions)
    yaws = np.unwrap(np.array(track.yaws)) + np.pi / 2  # yaw 0 is length along +y, ours along +x
    strayed = float(np.linalg.norm(positions - np.median(positions, 0), axis=1).max())
    turned = float(np.abs(yaws - np.median(yaws)).max())
    limit_m, limit_rad = (STILL_M, STILL_RAD) if all(track.stationary) else (JITTER_M, JITTER_RAD)
    is_moving = strayed > limit_m or turned > limit_rad
    if not is_moving:
        positions, yaws = np.median(positions, 0, keepdims=True), np.median(yaws, keepdims=True)
    return Actor(
        uid=uid,
        label=track.label,
        size_m=np.median(np.stack(track.sizes), 0),
        world_from_actor=Trajectory(times if is_moving else times[:1], positions, quaternion_from_yaw(yaws)),
        start_s=float(times[0]) - HALF_FRAME_S,
        end_s=float(times[-1]) + HALF_FRAME_S,
        is_moving=is_moving,
        look=Look(uid),
    )
