"""A drive as JSON: sensors, trajectories and boxes, float64 to the bit; shutters, lenses and beam tables, whose members
may be left out.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import math
from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, Trajectory
from ..json_file import Node
from ..lenses import PINHOLE, lens_from_dict
from ..lenses.lens import Lens, LensError
from .drive import (
    Actor,
    Appearance,
    Box,
    Camera,
    CameraModel,
    Drive,
    Lidar,
    LidarModel,
    Readouts,
    RollingShutter,
    SpinPhase,
    StaticCopy,
)

LIDAR_NUMBERS = ("sweep_s", "start_azimuth_rad", "time_offset_s", "min_range_m", "max_range_m")
LIDAR_TABLES = ("column_azimuth_rad", "column_time_s", "beam_time_s")
"""Members that a table of even columns lacks."""


def arrays_to_json(value: LidarModel | SpinPhase | Readouts | Trajectory) -> dict[str, Any]:
    """Return the members that are there, in a fixed order, float64 to the bit."""
    members = {field.name: getattr(value, field.name) for field in fields(value)}
    return {
        name: member.tolist() if isinstance(member, np.ndarray) else member
        for name, member in members.items()
        if member is not None
    }


def read_lidar_model(node: Node) -> LidarModel:
    """Return the beam table of a JSON object. Raises the node's error."""
    elevation = node.key("elevation_rad").array(-1)
    offset = node.key("azimuth_offset_rad").array(-1)
    if len(offset) != len(elevation):
        node.key("azimuth_offset_rad").fail(f"has {len(offset)} beams, elevation_rad has {len(elevation)}")
    columns, direction = node.key("columns").integer(at_least=1), node.key("direction").integer()
    if direction not in (-1, 1):
        node.key("direction").fail(f"must be -1 or 1, not {direction}")
    there = [name for name in LIDAR_TABLES if name in node.object()]
    counts = dict(zip(LIDAR_TABLES, (columns, columns, len(elevation)), strict=True))
    tables: dict[str, Any] = {name: node.key(name).array(counts[name]) for name in there}
    numbers: dict[str, Any] = {name: node.key(name).number() for name in LIDAR_NUMBERS}
    try:
        return LidarModel(elevation, offset, columns=columns, direction=direction, **numbers, **tables)
    except ValueError as fault:
        node.fail(str(fault))


def read_phase(node: Node) -> SpinPhase:
    """Return the phase of a JSON object. Raises the node's error."""
    times = _increasing_times(node.key("times_s"))
    return SpinPhase(times, node.key("turned_rad").array(len(times)))


def _increasing_times(node: Node) -> FloatArray:
    times = node.array(-1)
    if not len(times) or (np.diff(times) <= 0).any():
        node.fail("must be times that increase")
    return times


SHUTTER_AXES = ("rows", "columns")


def read_shutter(node: Node) -> RollingShutter:
    """Return the shutter of `RollingShutter.to_dict`; one without ``axis``, as earlier files have it, reads rows."""
    axis = node.key("axis").text() if "axis" in node.object() else "rows"
    if axis not in SHUTTER_AXES:
        node.key("axis").fail(f'must be "rows" or "columns", not "{axis}"')
    return RollingShutter(node.key("duration_s").number(), node.key("reference").number(), axis)


def read_lens(node: Node) -> Lens:
    """Return the lens that is the member ``lens`` of an object; an ideal pinhole where it has none."""
    if "lens" not in node.object():
        return PINHOLE
    try:
        return lens_from_dict(node.key("lens").value)
    except LensError as fault:
        node.key("lens").fail(str(fault))


def read_readouts(node: Node) -> Readouts | None:
    """Return the readouts that are the member ``readouts`` of an object; None where it has none. Raises the node's
    error."""
    if "readouts" not in node.object():
        return None
    node = node.key("readouts")
    times = _increasing_times(node.key("times_s"))
    stretch = node.key("stretch").array(len(times))
    if (stretch <= 0).any():
        node.key("stretch").fail("must be above 0")
    return Readouts(times, stretch)


def drive_to_json(drive: Drive) -> dict[str, Any]:
    """Return the drive as a JSON object. Two drives are equal to the bit exactly where their JSON is."""
    return {
        "name": drive.name,
        "world_origin": drive.world_origin.tolist(),
        "frames": list(drive.frames),
        "time_s": _times_to_json(drive.time_s),
        "world_from_ego": arrays_to_json(drive.world_from_ego),
        "cameras": {key: _camera_to_json(camera) for key, camera in drive.cameras.items()},
        "lidars": {key: _lidar_to_json(lidar) for key, lidar in drive.lidars.items()},
        "actors": {key: _actor_to_json(actor) for key, actor in drive.actors.items()},
        "static_copies": [
            {
                "uid": c.uid,
                "source": _box_to_json(c.source),
                "world_from_target": np.asarray(c.world_from_target).tolist(),
            }
            for c in drive.static_copies
        ],
        "static_removals": [_box_to_json(box) for box in drive.static_removals],
        **({} if drive.weather is None else {"weather": drive.weather.to_json()}),
        **({} if drive.sun is None else {"sun": drive.sun.to_json()}),
    }


def _read_trajectory(node: Node) -> Trajectory:
    try:
        return Trajectory(
            node.key("times_s").array(-1), node.key("positions").array(-1, 3), node.key("quaternions_wxyz").array(-1, 4)
        )
    except ValueError as fault:
        node.fail(str(fault))


def _times_to_json(time_s: dict[int, float]) -> list[list[float]]:
    return [[frame, float(time)] for frame, time in time_s.items()]


def _read_times(node: Node) -> dict[int, float]:
    times: dict[int, float] = {}
    for pair in node.elements():
        parts = list(pair.elements())
        if len(parts) != 2 or parts[0].integer() in times:
            pair.fail("must be a new frame and its time")
        times[parts[0].integer()] = parts[1].number()
    return times


def _camera_to_json(camera: Camera) -> dict[str, Any]:
    return {
        "model": camera.model.to_dict(),
        "world_from_camera": arrays_to_json(camera.world_from_camera),
        "time_s": _times_to_json(camera.time_s),
        **({"sees_ego_body": True} if camera.sees_ego_body else {}),
        **({} if camera.readouts is None else {"readouts": arrays_to_json(camera.readouts)}),
    }


def _read_camera(sensor_id: str, node: Node) -> Camera:
    model = node.key("model")
    focal = {name: model.key(name).number() for name in ("fx", "fy", "cx", "cy")}
    for name in ("fx", "fy"):
        if focal[name] <= 0:
            model.key(name).fail(f"must be above 0, not {focal[name]}")
    return Camera(
        sensor_id,
        CameraModel(
            width=model.key("width").integer(at_least=1),
            height=model.key("height").integer(at_least=1),
            shutter=read_shutter(model.key("shutter")),
            lens=read_lens(model),
            **focal,
        ),
        _read_trajectory(node.key("world_from_camera")),
        _read_times(node.key("time_s")),
        _read_flag(node, "sees_ego_body"),
        readouts=read_readouts(node),
    )


def _lidar_to_json(lidar: Lidar) -> dict[str, Any]:
    result: dict[str, Any] = {
        "model": arrays_to_json(lidar.model),
        "world_from_lidar": arrays_to_json(lidar.world_from_lidar),
        "time_s": _times_to_json(lidar.time_s),
    }
    if lidar.sees_ego_body:
        result["sees_ego_body"] = True
    if lidar.blocked is not None:
        result["blocked"] = base64.b64encode(np.packbits(lidar.blocked.astype(bool)).tobytes()).decode("ascii")
    if lidar.phase is not None:
        result["phase"] = arrays_to_json(lidar.phase)
    return result


def _read_lidar(sensor_id: str, node: Node) -> Lidar:
    model = read_lidar_model(node.key("model"))
    return Lidar(
        sensor_id,
        model,
        _read_trajectory(node.key("world_from_lidar")),
        _read_times(node.key("time_s")),
        _read_blocked(node.key("blocked"), model) if "blocked" in node.object() else None,
        _read_flag(node, "sees_ego_body"),
        phase=read_phase(node.key("phase")) if "phase" in node.object() else None,
    )


def _read_blocked(node: Node, model: LidarModel) -> NDArray[np.bool_]:
    """Cells (beams, columns) from packed bits, row by row, in base64."""
    cells = model.beams * model.columns
    try:
        packed = np.frombuffer(base64.b64decode(node.text(), validate=True), np.uint8)
    except binascii.Error as fault:
        node.fail(f"is not base64: {fault}")
    if len(packed) != -(-cells // 8):
        node.fail(f"holds {len(packed)} bytes, not the {-(-cells // 8)} of {model.beams} x {model.columns} cells")
    return np.unpackbits(packed, count=cells).reshape(model.beams, model.columns).astype(bool)


def _actor_to_json(actor: Actor) -> dict[str, Any]:
    return {
        "label": actor.label,
        "size_m": np.asarray(actor.size_m).tolist(),
        "world_from_actor": arrays_to_json(actor.world_from_actor),
        "start_s": _finite(actor.start_s),
        "end_s": _finite(actor.end_s),
        "is_moving": bool(actor.is_moving),
        "appearance": {
            "actor": actor.appearance.actor,
            "scene": actor.appearance.scene,
            **({"mesh": actor.appearance.mesh} if actor.appearance.mesh else {}),
        },
        "inserted": bool(actor.inserted),
        **({"scale": list(actor.scale)} if actor.is_scaled else {}),
        **({"is_ego_body": True} if actor.is_ego_body else {}),
        **({"lamps": [hashlib.sha256(lamp.content).hexdigest() for lamp in actor.lamps]} if actor.lamps else {}),
    }


def _finite(time_s: float) -> float | None:
    """Return a time; None where it is before or after all times."""
    return float(time_s) if math.isfinite(time_s) else None


def _read_flag(node: Node, name: str) -> bool:
    """Return a member that is left out where it is false."""
    return node.key(name).flag() if name in node.object() else False


def _read_size(node: Node) -> FloatArray:
    size = node.array(3)
    if (size <= 0).any():
        node.fail(f"must be above 0, not {size.tolist()}")
    return size


def _read_actor(uid: str, node: Node) -> Actor:
    appearance = node.key("look" if "look" in node.object() else "appearance")  # the former name is read, too
    return Actor(
        uid=uid,
        label=node.key("label").text(),
        size_m=_read_size(node.key("size_m")),
        world_from_actor=_read_trajectory(node.key("world_from_actor")),
        start_s=-math.inf if node.key("start_s").value is None else node.key("start_s").number(),
        end_s=math.inf if node.key("end_s").value is None else node.key("end_s").number(),
        is_moving=node.key("is_moving").flag(),
        appearance=Appearance(appearance.key("actor").text(), appearance.key("scene").text()),
        inserted=node.key("inserted").flag(),
        scale=_read_scale(node.key("scale")) if "scale" in node.object() else (1.0, 1.0, 1.0),
        is_ego_body=_read_flag(node, "is_ego_body"),
    )


def _read_scale(node: Node) -> tuple[float, float, float]:
    x, y, z = _read_size(node).tolist()
    return x, y, z


def _box_to_json(box: Box) -> dict[str, Any]:
    return {"world_from_box": np.asarray(box.world_from_box).tolist(), "size_m": np.asarray(box.size_m).tolist()}


def _read_box(node: Node) -> Box:
    return Box(node.key("world_from_box").pose(), _read_size(node.key("size_m")))


def read_drive(node: Node) -> Drive:
    """Return the drive of `drive_to_json`; of meshes that are actors, only the boxes, no weather and no sun: its
    images show them. Raises the node's error."""
    frames = tuple(frame.integer() for frame in node.key("frames").elements())
    time_s = _read_times(node.key("time_s"))
    missing = [frame for frame in frames if frame not in time_s]
    if missing:
        node.key("time_s").fail(f"has no time of frame {missing[0]}")
    return Drive(
        name=node.key("name").text(),
        frames=frames,
        time_s=time_s,
        world_from_ego=_read_trajectory(node.key("world_from_ego")),
        cameras={key: _read_camera(key, child) for key, child in node.key("cameras").members()},
        lidars={key: _read_lidar(key, child) for key, child in node.key("lidars").members()},
        actors={key: _read_actor(key, child) for key, child in node.key("actors").members()},
        static_copies=tuple(
            StaticCopy(child.key("uid").text(), _read_box(child.key("source")), child.key("world_from_target").pose())
            for child in node.key("static_copies").elements()
        ),
        static_removals=tuple(_read_box(child) for child in node.key("static_removals").elements()),
        world_origin=node.key("world_origin").array(3),
    )
