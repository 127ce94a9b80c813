"""States and sensors as text for a message between processes: versioned, checked, and without loss.

An encoding is base64 of a header in JSON, the float64 numbers that the header counts, and a digest of both. States that
are equal have equal encodings; what is decoded has the digest of what was encoded.
"""

from __future__ import annotations

import base64
import binascii
import hashlib
import json
import struct
from collections.abc import Iterable
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from ..errors import UnisimError
from ..geometry import FloatArray, Trajectory
from ..json_file import Node
from .drive import Actor, Appearance, Box, Camera, CameraModel, Lidar, LidarModel, Readouts, SpinPhase, StaticCopy
from .drive_json import LIDAR_TABLES
from .lamps import ActorLamp
from .light import Sunlight
from .replay import WorldState
from .weather import Weather

ENCODING_VERSION = 2
MAGIC = b"UWS"
DIGEST_BYTES = 16
MAX_NUMBERS = 1 << 24
_HEAD = struct.Struct("<3sBI")


class EncodingError(UnisimError):
    """Text that is not a valid encoding."""


def encode_state(state: WorldState) -> str:
    """Return a state as text."""
    numbers: list[FloatArray] = [np.array([state.start_s, state.end_s]), *_keys(state.world_from_ego)]
    actors = []
    for actor in state.actors:
        appearance, trajectory = actor.appearance, actor.world_from_actor
        words = [actor.uid, actor.label, appearance.actor, appearance.scene, appearance.mesh]
        actors.append([*words, actor.is_moving, actor.inserted, actor.is_ego_body, len(trajectory.times_s)])
        about = [*actor.size_m, *actor.scale, actor.start_s, actor.end_s, trajectory.start_walked_m]
        numbers += [np.array(about), *_keys(trajectory)]
    for copy in state.static_copies:
        numbers += [*_box(copy.source), copy.world_from_target]
    for box in state.removed_boxes:
        numbers += _box(box)
    header: dict[str, Any] = {
        "kind": "state",
        "ego_keys": len(state.world_from_ego.times_s),
        "actors": actors,
        "static_copies": [copy.uid for copy in state.static_copies],
        "removed_boxes": len(state.removed_boxes),
    }
    if lamps := {actor.uid: [lamp.to_json() for lamp in actor.lamps] for actor in state.actors if actor.lamps}:
        header["lamps"] = lamps
    if state.weather is not None:
        header["weather"] = state.weather.to_dict()
    if state.light is not None:
        header["light"] = state.light.to_json()
    return _packed(header, numbers)


def decode_state(text: str) -> WorldState:
    """Return the state that a text encodes. Raises `EncodingError`."""
    header, numbers = _unpacked(text, "state")
    try:
        start_s, end_s = numbers.take(2).tolist()
        ego = numbers.trajectory(header["ego_keys"])
        actors = tuple(_actor(about, numbers) for about in header["actors"])
        lamps = dict(Node(header.get("lamps", {}), "lamps", EncodingError).members())
        actors = tuple(
            replace(actor, lamps=tuple(map(ActorLamp.from_json, lamps[actor.uid].elements())))
            if actor.uid in lamps
            else actor
            for actor in actors
        )
        copies = tuple(
            StaticCopy(str(uid), numbers.box(), numbers.take(16).reshape(4, 4)) for uid in header["static_copies"]
        )
        removed = tuple(numbers.box() for _ in range(header["removed_boxes"]))
        weather = Weather.from_dict(header["weather"]) if "weather" in header else None
        light = Sunlight.from_json(Node(header["light"], "light", EncodingError)) if "light" in header else None
        numbers.finish()
    except (KeyError, TypeError, ValueError) as fault:
        raise EncodingError(f"a state of the world that was sent cannot be read: {fault}") from fault
    return WorldState(start_s, end_s, ego, actors, copies, removed, weather, light)


def encode_sensor(sensor: Camera | Lidar, start_s: float, end_s: float) -> str:
    """Return a sensor as text, with the keys of its trajectory for an exposure from ``start_s`` to ``end_s``, seconds,
    and without frames of a log."""
    trajectory = sensor.trajectory.between(start_s, end_s)
    if isinstance(sensor, Camera):
        header: dict[str, Any] = {"kind": "camera", "model": sensor.model.to_dict(), "full_width": sensor.full_width}
        numbers = _keys(trajectory)
        if sensor.readouts is not None:
            header["readouts"] = len(sensor.readouts.times_s)
            numbers = [*numbers, sensor.readouts.times_s, sensor.readouts.stretch]
    else:
        more = [name for name in LIDAR_TABLES if getattr(sensor.model, name) is not None]
        tables = ("elevation_rad", "azimuth_offset_rad", *more)
        header = {
            "kind": "lidar",
            "model": {
                name: value for name, value in asdict(sensor.model).items() if name not in (*tables, *LIDAR_TABLES)
            },
            "beams": sensor.model.beams,
            "blocked": None
            if sensor.blocked is None
            else base64.b64encode(np.packbits(sensor.blocked).tobytes()).decode(),
        }
        numbers = [*_keys(trajectory), *(getattr(sensor.model, name) for name in tables)]
        if more:
            header["tables"] = more
        if sensor.phase is not None:
            header["phases"] = len(sensor.phase.times_s)
            numbers += [sensor.phase.times_s, sensor.phase.turned_rad]
    header |= {"id": sensor.sensor_id, "sees_ego_body": sensor.sees_ego_body, "keys": len(trajectory.times_s)}
    return _packed(header, numbers)


def decode_sensor(text: str) -> Camera | Lidar:
    """Return the sensor that a text encodes. Raises `EncodingError`."""
    header, numbers = _unpacked(text, "camera", "lidar")
    try:
        trajectory = numbers.trajectory(header["keys"])
        if header["kind"] == "camera":
            count = header.get("readouts")
            readouts = None if count is None else Readouts(numbers.take(count), numbers.take(count))
            sensor: Camera | Lidar = Camera(
                str(header["id"]), CameraModel.from_dict(header["model"]), trajectory, {},
                bool(header["sees_ego_body"]),
                header["full_width"],
                readouts,
            )  # fmt: skip
        else:
            beams, columns = header["beams"], header["model"]["columns"]
            elevation, offset = numbers.take(beams), numbers.take(beams)
            counts = dict(zip(LIDAR_TABLES, (columns, columns, beams), strict=True))
            tables: dict[str, Any] = {name: numbers.take(counts[name]) for name in header.get("tables", ())}
            phases = header.get("phases")
            phase = None if phases is None else SpinPhase(numbers.take(phases), numbers.take(phases))
            model = LidarModel(elevation, offset, **header["model"], **tables)
            blocked = None
            if header["blocked"] is not None:
                shape = model.beams, model.columns
                bits = np.frombuffer(base64.b64decode(header["blocked"], validate=True), np.uint8)
                blocked = np.unpackbits(bits, count=shape[0] * shape[1]).astype(bool).reshape(shape)
            sensor = Lidar(str(header["id"]), model, trajectory, {}, blocked, bool(header["sees_ego_body"]), phase)
        numbers.finish()
    except (KeyError, TypeError, ValueError) as fault:
        raise EncodingError(f"a sensor that was sent cannot be read: {fault}") from fault
    return sensor


class _Numbers:
    """Float64 numbers, taken one after the other."""

    def __init__(self, values: FloatArray) -> None:
        self.values, self.at = values, 0

    def take(self, count: int) -> FloatArray:
        if not 0 <= count <= len(self.values) - self.at:
            raise ValueError(f"{count} numbers are wanted, {len(self.values) - self.at} are left")
        self.at += count
        return self.values[self.at - count : self.at]

    def trajectory(self, keys: int) -> Trajectory:
        return Trajectory(self.take(keys), self.take(3 * keys).reshape(-1, 3), self.take(4 * keys).reshape(-1, 4))

    def box(self) -> Box:
        return Box(self.take(16).reshape(4, 4), self.take(3))

    def finish(self) -> None:
        if self.at != len(self.values):
            raise ValueError(f"{len(self.values) - self.at} numbers too many")


def _actor(about: Any, numbers: _Numbers) -> Actor:
    uid, label, appearance, scene, mesh, is_moving, inserted, is_ego_body, keys = about
    x = numbers.take(9)
    trajectory = replace(numbers.trajectory(keys), start_walked_m=float(x[8]))
    return Actor(
        str(uid), str(label), x[:3], trajectory, float(x[6]), float(x[7]), bool(is_moving),
        Appearance(str(appearance), str(scene), str(mesh)),
        bool(inserted), bool(is_ego_body), (float(x[3]), float(x[4]), float(x[5])),
    )  # fmt: skip


def _keys(trajectory: Trajectory) -> list[FloatArray]:
    return [trajectory.times_s, trajectory.positions, trajectory.quaternions_wxyz]


def _box(box: Box) -> list[FloatArray]:
    return [box.world_from_box, box.size_m]


def _packed(header: dict[str, Any], numbers: Iterable[FloatArray]) -> str:
    head = json.dumps(header, separators=(",", ":")).encode()
    body = b"".join(np.ascontiguousarray(part, "<f8").tobytes() for part in numbers)
    data = _HEAD.pack(MAGIC, ENCODING_VERSION, len(head)) + head + body
    return base64.b64encode(data + _digest(data)).decode()


def _unpacked(text: str, *kinds: str) -> tuple[dict[str, Any], _Numbers]:
    """Return header and numbers. Raises `EncodingError`."""
    what = f"a {kinds[0] if len(kinds) == 1 else 'sensor'} that was sent"
    try:
        data = base64.b64decode(text, validate=True)
    except (TypeError, ValueError, binascii.Error) as fault:
        raise EncodingError(f"{what} is no base64: {fault}") from fault
    if len(data) < _HEAD.size + DIGEST_BYTES or data[:3] != MAGIC:
        raise EncodingError(f"{what} is no encoding of one")
    _, version, length = _HEAD.unpack_from(data)
    if version != ENCODING_VERSION:
        raise EncodingError(
            f"{what} has version {version}, not {ENCODING_VERSION}: it is of another version of the extension"
        )
    if _digest(data[:-DIGEST_BYTES]) != data[-DIGEST_BYTES:]:
        raise EncodingError(f"{what} is damaged: its digest is another one")
    body = data[_HEAD.size + length : -DIGEST_BYTES]
    if len(body) % 8 or len(body) > 8 * MAX_NUMBERS or _HEAD.size + length > len(data) - DIGEST_BYTES:
        raise EncodingError(f"{what} has {len(body)} bytes of numbers, which is not a whole number of them")
    try:
        header = json.loads(data[_HEAD.size : _HEAD.size + length])
    except (ValueError, RecursionError) as fault:
        raise EncodingError(f"{what} has a header that is no JSON: {fault}") from fault
    if not isinstance(header, dict) or header.get("kind") not in kinds:
        raise EncodingError(f"{what} is of another kind")
    values = np.frombuffer(body, "<f8").astype(np.float64)
    if not np.isfinite(values).all():
        raise EncodingError(f"{what} has numbers that are not finite")
    return header, _Numbers(values)


def _digest(data: bytes) -> bytes:
    return hashlib.blake2b(data, digest_size=DIGEST_BYTES).digest()
