"""NCore's cuboid observations and actors: one actor for each track.

An observation's pose is given in a reference frame at its time: centre, size and Euler angles, turns about the frame's fixed x,
then y, then z. The class's name is kept as it is.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ...errors import LogError
from ...geometry import FloatArray, Trajectory, TrajectoryError, quaternion_from_matrix
from ...json_file import Node
from ...world.drive import Actor, Appearance

JITTER_M, JITTER_RAD = 0.1, 0.05
"""An actor that strays no further from its median pose is taken to stand still."""
EQUAL = 1e-9


@dataclass
class _Track:
    label: str
    times_us: list[int] = field(default_factory=list)
    poses: list[FloatArray] = field(default_factory=list)
    sizes: list[FloatArray] = field(default_factory=list)


@dataclass(frozen=True)
class _Seen:
    uid: str
    label: str
    time_us: int
    frame: str
    frame_time_us: int
    pose: FloatArray
    size: FloatArray


def read_actors(
    observations: object,
    place: str,
    world_from: Callable[[str, FloatArray], FloatArray],
    epoch_us: int,
    margin_s: float,
    given: Mapping[str, tuple[float, float, bool]],
) -> dict[str, Actor]:
    """Return the actors of observations, JSON values, by track. ``world_from``: poses (T, 4, 4) of a frame at times (T,).

    ``given`` says when an actor is there, and whether it moves; others are there ``margin_s`` longer than they are seen. Raises
    `LogError`.
    """
    seen = [_read(node) for node in Node(observations, f"{place}: cuboids", LogError).elements()]
    tracks: dict[str, _Track] = {}
    for frame in sorted({one.frame for one in seen}):
        part = [one for one in seen if one.frame == frame]
        at = np.array([one.frame_time_us - epoch_us for one in part]) / 1e6
        placed = world_from(frame, at) @ np.stack([one.pose for one in part])
        for one, pose in zip(part, placed, strict=True):
            track = tracks.setdefault(one.uid, _Track(one.label))
            track.times_us.append(one.time_us)
            track.poses.append(pose)
            track.sizes.append(one.size)
    try:
        return {uid: _actor(uid, tracks[uid], epoch_us, margin_s, given.get(uid)) for uid in sorted(tracks)}
    except TrajectoryError as fault:
        raise LogError(f"{place}: the cuboids of a track: {fault}") from fault


def observations_of(
    actor: Actor, frames_s: Iterable[float], start_us: int, end_us: int, epoch_us: int
) -> list[dict[str, Any]]:
    """Return the JSON values of an actor's observations in the world: at its own keys and the frames' times while it is there."""
    track = actor.world_from_actor
    first = max(actor.start_s, (start_us - epoch_us) / 1e6)
    last = min(actor.end_s, (end_us - epoch_us) / 1e6)
    keys = track.times_s if len(track.times_s) > 1 else np.zeros(0)
    times = np.concatenate([keys, np.array(list(frames_s))])
    times = times[(times >= first) & (times <= last)]
    if len(keys) and first <= last:  # beyond its own keys, too, the actor goes on as it did
        times = np.append(times, [first, last])
    whole = np.unique(np.clip(np.rint(times * 1e6).astype(np.int64) + epoch_us, start_us, end_us))
    poses = track.at((whole - epoch_us) / 1e6)
    size = [float(x) for x in actor.size_m]
    return [
        {
            "track_id": actor.uid,
            "class_id": actor.label,
            "timestamp_us": int(time),
            "reference_frame_id": "world",
            "reference_frame_timestamp_us": int(time),
            "bbox3": {"centroid": pose[:3, 3].tolist(), "dim": size, "rot": euler_of(pose[:3, :3])},
        }
        for time, pose in zip(whole, poses, strict=True)
    ]


def euler_of(rotation: FloatArray) -> list[float]:
    """Return the angles (3,) about fixed x, y and z of a rotation (3, 3)."""
    level = float(np.hypot(rotation[0, 0], rotation[1, 0]))
    about_y = float(np.arctan2(-rotation[2, 0], level))
    if level < 1e-9:  # x and z turn about one axis there: all of it is x's
        return [float(np.arctan2(-rotation[1, 2], rotation[1, 1])), about_y, 0.0]
    about_x = float(np.arctan2(rotation[2, 1], rotation[2, 2]))
    return [about_x, about_y, float(np.arctan2(rotation[1, 0], rotation[0, 0]))]


def rotation_of(euler: FloatArray) -> FloatArray:
    """Return the rotation (3, 3) of angles (3,) about fixed x, then y, then z."""
    (a, b, c), (u, v, w) = np.cos(euler), np.sin(euler)
    about_x = np.array([[1, 0, 0], [0, a, -u], [0, u, a]])
    about_y = np.array([[b, 0, v], [0, 1, 0], [-v, 0, b]])
    about_z = np.array([[c, -w, 0], [w, c, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def _read(node: Node) -> _Seen:
    box = node.key("bbox3")
    size = box.key("dim").array(3)
    if (size <= 0).any():
        box.key("dim").fail(f"is the size {size.tolist()} m")
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = rotation_of(box.key("rot").array(3)), box.key("centroid").array(3)
    return _Seen(
        node.key("track_id").text(),
        node.key("class_id").text(),
        node.key("timestamp_us").integer(),
        node.key("reference_frame_id").text(),
        node.key("reference_frame_timestamp_us").integer(),
        pose,
        size,
    )


def _actor(uid: str, track: _Track, epoch_us: int, margin_s: float, given: tuple[float, float, bool] | None) -> Actor:
    order = np.argsort(np.array(track.times_us), kind="stable")
    times_us = np.array(track.times_us)[order]
    new = np.append(True, np.diff(times_us) > 0)  # of two at one moment the first stays
    times, poses = (times_us[new] - epoch_us) / 1e6, np.stack(track.poses)[order][new]
    positions, quaternions = poses[:, :3, 3], quaternion_from_matrix(poses[:, :3, :3])
    if given is None:
        middle = int(np.linalg.norm(positions - np.median(positions, 0), axis=1).argmin())
        strayed = np.linalg.norm(positions - positions[middle], axis=1).max()
        aligned = np.abs(quaternions @ quaternions[middle]).min()
        moves = bool(strayed > JITTER_M or 2 * np.arccos(min(aligned, 1.0)) > JITTER_RAD)
        start, end = float(times[0]) - margin_s, float(times[-1]) + margin_s
        still = not moves
    else:
        middle = 0
        start, end, moves = given
        still = np.abs(poses - poses[0]).max() < EQUAL
    if still:
        times, positions, quaternions = times[:1], positions[middle][None], quaternions[middle][None]
    return Actor(
        uid=uid,
        label=track.label,
        size_m=np.median(np.stack(track.sizes), 0),
        world_from_actor=Trajectory(times, positions, quaternions),
        start_s=start,
        end_s=end,
        is_moving=moves,
        appearance=Appearance(uid),
    )
