"""A drive as JSON: sensors, trajectories and boxes, float64 to the bit. What actors look like is not part of it."""

from __future__ import annotations

import base64
import binascii
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ..geometry import BoolArray, Trajectory, TrajectoryError
from ..json_file import Node
from ..lenses.lens import LensError
from .camera_json import read_lens, read_shutter
from .drive import Actor, Appearance, Camera, CameraModel, Drive, Lidar, LidarModel
from .lidar_json import lidar_model_to_json, phase_to_json, read_lidar_model, read_phase


def drive_to_json(drive: Drive) -> dict[str, Any]:
    """Return a drive's members, in a fixed order."""
    return {
        "name": drive.name,
        "world_origin": np.asarray(drive.world_origin).tolist(),
        "time_s": _pairs({frame: drive.time_s[frame] for frame in drive.frames}),
        "world_from_ego": _track(drive.world_from_ego),
        "cameras": {name: _camera(camera) for name, camera in drive.cameras.items()},
        "lidars": {name: _lidar(lidar) for name, lidar in drive.lidars.items()},
        "actors": {uid: _actor(actor) for uid, actor in drive.actors.items()},
    }


def read_drive(node: Node) -> Drive:
    """Return the drive of `drive_to_json`. Raises the node's error."""
    time_s = _read_pairs(node.key("time_s"))
    if list(time_s) != sorted(time_s):
        node.key("time_s").fail("must be frames whose numbers increase")
    return Drive(
        name=node.key("name").text(),
        frames=tuple(time_s),
        time_s=time_s,
        world_from_ego=_read_track(node.key("world_from_ego")),
        cameras={name: _read_camera(name, one) for name, one in node.key("cameras").members()},
        lidars={name: _read_lidar(name, one) for name, one in node.key("lidars").members()},
        actors={uid: _read_actor(uid, one) for uid, one in node.key("actors").members()},
        world_origin=node.key("world_origin").array(3),
    )


def _camera(camera: Camera) -> dict[str, Any]:
    return {
        "model": camera.model.to_dict(),
        "time_s": _pairs(camera.time_s),
        "sees_ego_body": camera.sees_ego_body,
        "track": _track(camera.world_from_camera),
    }


def _read_camera(name: str, node: Node) -> Camera:
    model = node.key("model")
    width, height = (model.key(side).integer(at_least=1) for side in ("width", "height"))
    fx, fy, cx, cy = (model.key(key).number() for key in ("fx", "fy", "cx", "cy"))
    try:
        found = CameraModel(width, height, fx, fy, cx, cy, read_shutter(model.key("shutter")), read_lens(model))
    except LensError as fault:
        model.fail(str(fault))
    track, times = _read_track(node.key("track")), _read_pairs(node.key("time_s"))
    return Camera(name, found, track, times, node.key("sees_ego_body").flag())


def _lidar(lidar: Lidar) -> dict[str, Any]:
    more: dict[str, Any] = {} if lidar.phase is None else {"phase": phase_to_json(lidar.phase)}
    if lidar.blocked is not None:
        more["blocked"] = base64.b64encode(np.packbits(lidar.blocked).tobytes()).decode()
    return {
        "model": lidar_model_to_json(lidar.model),
        "time_s": _pairs(lidar.time_s),
        "sees_ego_body": lidar.sees_ego_body,
        "track": _track(lidar.world_from_lidar),
        **more,
    }


def _read_lidar(name: str, node: Node) -> Lidar:
    there, model = node.object(), read_lidar_model(node.key("model"))
    phase = read_phase(node.key("phase")) if "phase" in there else None
    blocked = _read_bits(node.key("blocked"), model) if "blocked" in there else None
    track, times = _read_track(node.key("track")), _read_pairs(node.key("time_s"))
    return Lidar(name, model, track, times, blocked, node.key("sees_ego_body").flag(), phase)


def _read_bits(node: Node, model: LidarModel) -> BoolArray:
    count = model.beams * model.columns
    try:
        packed = np.frombuffer(base64.b64decode(node.text(), validate=True), np.uint8)
    except (binascii.Error, ValueError):
        node.fail("is no base64")
    if len(packed) != -(-count // 8):
        node.fail(f"holds {len(packed)} bytes, not those of {model.beams} x {model.columns} cells")
    return np.unpackbits(packed, count=count).astype(bool).reshape(model.beams, model.columns)


def _actor(actor: Actor) -> dict[str, Any]:
    return {
        "class": actor.label,
        "size_m": np.asarray(actor.size_m).tolist(),
        "start_s": actor.start_s if math.isfinite(actor.start_s) else None,
        "end_s": actor.end_s if math.isfinite(actor.end_s) else None,
        "is_moving": actor.is_moving,
        "inserted": actor.inserted,
        "is_ego_body": actor.is_ego_body,
        "track": _track(actor.world_from_actor),
    }


def _read_actor(uid: str, node: Node) -> Actor:
    start, end = node.key("start_s"), node.key("end_s")
    size = node.key("size_m").array(3)
    if not (size > 0).all():
        node.key("size_m").fail("must be above 0")
    return Actor(
        uid=uid,
        label=node.key("class").text(),
        size_m=size,
        world_from_actor=_read_track(node.key("track")),
        start_s=-math.inf if start.value is None else start.number(),
        end_s=math.inf if end.value is None else end.number(),
        is_moving=node.key("is_moving").flag(),
        appearance=Appearance(uid),
        inserted=node.key("inserted").flag(),
        is_ego_body=node.key("is_ego_body").flag(),
    )


def _track(track: Trajectory) -> dict[str, Any]:
    return {name: getattr(track, name).tolist() for name in ("times_s", "positions", "quaternions_wxyz")}


def _read_track(node: Node) -> Trajectory:
    times = node.key("times_s").array(-1)
    positions, quaternions = node.key("positions").array(-1, 3), node.key("quaternions_wxyz").array(-1, 4)
    try:
        return Trajectory(times, positions, quaternions)
    except TrajectoryError as fault:
        node.fail(str(fault))


def _pairs(values: Mapping[int, float]) -> list[list[float]]:
    return [[number, values[number]] for number in values]


def _read_pairs(node: Node) -> dict[int, float]:
    rows = [list(row.elements()) for row in node.elements()]
    for row, one in zip(rows, node.elements(), strict=True):
        if len(row) != 2:
            one.fail("must be a number and its time")
    return {row[0].integer(): row[1].number() for row in rows}
