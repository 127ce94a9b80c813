"""NCore's cuboid observations and actors: one actor for each track.

An observation's pose is given in a reference frame at its time: centre, size and Euler angles, turns about the frame's fixed x,
then y, then z. The class's name is kept as it is.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError
from ...geometry import FloatArray, Trajectory, TrajectoryError, quaternion_from_matrix
from ...json_file import MAX_INTEGER, Node
from ...world.drive import Actor, Appearance

JITTER_M, JITTER_RAD = 0.1, 0.05
"""An actor that strays no further from its median pose is taken to stand still."""
EQUAL = 1e-9


@dataclass(frozen=True)
class _Seen:
    """Observations, N of them, as columns."""

    uid: list[str]
    label: list[str]
    frame: list[str]
    time_us: NDArray[np.int64]
    frame_time_us: NDArray[np.int64]
    centre: FloatArray
    size: FloatArray
    euler: FloatArray


def read_actors(
    observations: Callable[[], Iterable[Any]],
    place: str,
    world_from: Callable[[str, FloatArray], FloatArray],
    epoch_us: int,
    margin_s: float,
    given: Mapping[str, tuple[float, float, bool]],
) -> dict[str, Actor]:
    """Return the actors of observations, JSON values, by track. ``world_from``: poses (T, 4, 4) of a frame at times (T,).
    ``observations`` gives them from the first on, each time that it is called.

    ``given`` says when an actor is there, and whether it moves; others are there ``margin_s`` longer than they are seen. Raises
    `LogError`.
    """
    seen = _columns(observations())
    if seen is None:
        seen = _checked(Node([*observations()], f"{place}: cuboids", LogError))
    poses = np.zeros((len(seen.uid), 4, 4))
    poses[:, :3, :3], poses[:, :3, 3], poses[:, 3, 3] = rotation_of(seen.euler), seen.centre, 1
    frames = np.array(seen.frame)
    for frame in sorted(set(seen.frame)):
        part = np.flatnonzero(frames == frame)
        poses[part] = world_from(frame, (seen.frame_time_us[part] - epoch_us) / 1e6) @ poses[part]
    tracks: dict[str, list[int]] = {}
    for row, uid in enumerate(seen.uid):
        tracks.setdefault(uid, []).append(row)
    actors = {}
    for uid in sorted(tracks):
        part = np.array(tracks[uid])
        part = part[np.argsort(seen.time_us[part], kind="stable")]
        part = part[np.append(True, np.diff(seen.time_us[part]) > 0)]  # of two at one moment the first stays
        times = (seen.time_us[part] - epoch_us) / 1e6
        size = np.median(seen.size[tracks[uid]], 0)
        try:
            actors[uid] = _actor(uid, seen.label[tracks[uid][0]], size, times, poses[part], margin_s, given.get(uid))
        except TrajectoryError as fault:
            raise LogError(f"{place}: the cuboids of {uid!r:.80}: {fault}") from fault
    return actors


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
    """Return rotations (..., 3, 3) of angles (..., 3) about fixed x, then y, then z."""
    (a, b, c), (u, v, w) = np.moveaxis(np.cos(euler), -1, 0), np.moveaxis(np.sin(euler), -1, 0)
    rows = [
        [b * c, u * v * c - a * w, a * v * c + u * w],
        [b * w, u * v * w + a * c, a * v * w - u * c],
        [-v, u * b, a * b],
    ]
    return np.stack([np.stack(row, -1) for row in rows], -2)


def _columns(rows: Iterable[Any]) -> _Seen | None:
    """The observations as columns; None where there is something wrong with them, and `_checked` says what.

    Of a long drive's rows none is kept: as objects they take more memory than all else of it.
    """
    known: dict[str, str] = {}
    texts: list[list[str]] = [[], [], []]
    times, numbers = (array("q"), array("q")), array("d")
    try:
        for row in rows:
            box = row["bbox3"]
            for column, name in zip(texts, ("track_id", "class_id", "reference_frame_id"), strict=True):
                if type(row[name]) is not str:
                    return None
                column.append(known.setdefault(row[name], row[name]))
            for time, name in zip(times, ("timestamp_us", "reference_frame_timestamp_us"), strict=True):
                time.append(row[name])
            for name in ("centroid", "dim", "rot"):
                x, y, z = box[name]
                numbers.extend((x, y, z))
    except (KeyError, TypeError, ValueError, OverflowError):
        return None
    time_us, frame_time_us = (np.array(time, np.int64) for time in times)
    centre, size, euler = np.array(numbers, np.float64).reshape(-1, 3, 3).swapaxes(0, 1)
    whole = all(((-MAX_INTEGER < time) & (time < MAX_INTEGER)).all() for time in (time_us, frame_time_us))
    if not whole or not np.isfinite(numbers).all() or (size <= 0).any():
        return None
    uid, label, frame = texts
    return _Seen(uid, label, frame, time_us, frame_time_us, centre, size, euler)


def _checked(rows: Node) -> _Seen:
    """The observations, one by one: raises the node's error for the first that is wrong."""
    seen = [_read(node) for node in rows.elements()]
    if not seen:
        return _Seen([], [], [], *np.zeros((2, 0), np.int64), *np.zeros((3, 0, 3)))
    uid, label, frame, time_us, frame_time_us, centre, size, euler = zip(*seen, strict=True)
    times = np.array(time_us), np.array(frame_time_us)
    return _Seen([*uid], [*label], [*frame], *times, np.stack(centre), np.stack(size), np.stack(euler))


def _read(node: Node) -> tuple[str, str, str, int, int, FloatArray, FloatArray, FloatArray]:
    box = node.key("bbox3")
    size = box.key("dim").array(3)
    if (size <= 0).any():
        box.key("dim").fail(f"is the size {size.tolist()} m")
    return (
        node.key("track_id").text(),
        node.key("class_id").text(),
        node.key("reference_frame_id").text(),
        node.key("timestamp_us").integer(),
        node.key("reference_frame_timestamp_us").integer(),
        box.key("centroid").array(3),
        size,
        box.key("rot").array(3),
    )


def _actor(
    uid: str,
    label: str,
    size_m: FloatArray,
    times: FloatArray,
    poses: FloatArray,
    margin_s: float,
    given: tuple[float, float, bool] | None,
) -> Actor:
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
        label=label,
        size_m=size_m,
        world_from_actor=Trajectory(times, positions, quaternions),
        start_s=start,
        end_s=end,
        is_moving=moves,
        appearance=Appearance(uid),
    )
