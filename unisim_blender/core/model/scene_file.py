"""The files of a trained scene: `scene.json` and `weights.safetensors`.

`scene.json` is readable: what the scene was trained on, its configuration and its refined drive. Every float64 survives
writing and reading bit for bit. The weights are arrays that lie where the file is mapped.
"""

from __future__ import annotations

import functools
import hashlib
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..data.exposures import Exposures
from ..data.fingerprint import Fingerprint
from ..data.own_vehicle import check_outlines
from ..errors import SceneError, short
from ..files import file_stamp, sha256_of_file, write_file
from ..geometry import FloatArray
from ..json_file import Node, parse_json, read_bytes
from ..world.drive import Box, Drive
from ..world.drive_json import drive_to_json, read_drive
from ..world.replay import parked_boxes
from .config import ModelConfig

FORMAT = "unisim-scene"
VERSION = 1
HEADER_NAME = "scene.json"
WEIGHTS_NAME = "weights.safetensors"


@dataclass(frozen=True)
class SceneHeader:
    """Contents of `scene.json`. ``path`` is the scene's folder; ``drive`` has the refined tracklets and camera poses.

    ``model``, ``volume`` and ``training`` are free dictionaries that the trainer writes and the loader reads.
    ``weights`` is the SHA-256 of the weights that the header belongs to, "" where it is not known. ``fingerprint``
    tells whether a log is of the drive that the scene was trained on; None in scenes of versions that did not keep one.
    """

    path: Path
    name: str
    log_name: str
    log_path: str
    world_origin: FloatArray
    model: dict[str, Any]
    volume: dict[str, Any]
    drive: Drive
    training: dict[str, Any]
    weights: str = ""
    fingerprint: Fingerprint | None = None

    @property
    def method(self) -> str:
        """The method that the scene was trained by. Scenes of versions that did not store it are told
        by their shapes."""
        if "method" in self.training:
            return str(self.training["method"])
        if self.model.get("density") != "volume":
            return "neural"
        return "ngp" if self.model.get("actors") == "none" else "nsg"

    @property
    def exposures(self) -> Exposures:
        """The gains of the images that the scene was trained on."""
        return Exposures.from_json(Node(self.training.get("exposures", {}), "training.exposures", SceneError))

    @property
    def parked(self) -> dict[str, Box]:
        """Boxes of actors that stood still throughout the recording, by their ids: the static field does not hold them.
        A scene that is one field holds everything, so it has none."""
        return {} if ModelConfig.from_dict(self.model).actors == "none" else parked_boxes(self.drive)


def header_path(path: Path) -> Path:
    """Return the header's file, given the scene's folder or the file itself."""
    path = Path(path)
    return path if path.suffix == ".json" else path / HEADER_NAME


def read_scene_header(path: Path) -> SceneHeader:
    """Read the header of the scene in folder ``path``. Raises `SceneError` naming the file and the value at fault."""
    return read_header(path)[0]


def read_header(path: Path) -> tuple[SceneHeader, str]:
    """Read the header of the scene in folder ``path``, and the SHA-256 of its file in hexadecimal. Raises
    `SceneError`."""
    file = header_path(path)
    content = read_bytes(file, SceneError)
    document = Node(parse_json(content, file, SceneError), f"{file}: ", SceneError)
    return _header(file, document), hashlib.sha256(content).hexdigest()


def _header(file: Path, document: Node) -> SceneHeader:
    if document.object().get("format") != FORMAT:
        raise SceneError(
            f'{file}: is no trained scene: its format is {short(document.value.get("format"))}, not "{FORMAT}"'
        )
    version = document.key("version").integer(at_least=1)
    if version > VERSION:
        raise SceneError(f"{file}: has version {version}, newer than the {VERSION} that this program reads")
    log, drive = document.key("log"), read_drive(document.key("drive"))
    if not drive.frames:
        document.key("drive").key("time_s").fail("a drive needs at least one frame")
    return SceneHeader(
        path=file.parent,
        name=document.key("name").text(),
        log_name=log.key("name").text(),
        log_path=log.key("path").text(),
        world_origin=document.key("world_origin").array(3),
        model=document.key("model").object(),
        volume=document.key("volume").object(),
        drive=drive,
        training=_read_training(document.key("training")),
        weights=document.key("weights").text() if "weights" in document.object() else "",
        fingerprint=Fingerprint.from_json(log.key("fingerprint")) if "fingerprint" in log.object() else None,
    )


def _read_training(node: Node) -> dict[str, Any]:
    """Return a trainer's dictionary, with the members checked that a renderer reads."""
    there = node.object()
    for name in ("cameras", "lidars", "without"):
        for child in node.key(name).elements() if name in there else ():
            child.text()
    for child in node.key("frames").elements() if "frames" in there else ():
        child.integer()
    if there.get("width") is not None:
        node.key("width").integer(at_least=1)
    if "method" in there:
        node.key("method").text()
    for name in ("iterations", "seed"):
        if name in there:
            node.key(name).integer()
    if "seconds" in there:
        node.key("seconds").number()
    for _, share in node.key("accuracy").members() if "accuracy" in there else ():
        if not 0 <= share.number() <= 1:
            share.fail("a fraction is from 0 to 1")
    if there.get("own_vehicle") is not None:
        check_outlines(node.key("own_vehicle"))
    if "exposures" in there:
        Exposures.from_json(node.key("exposures"))
    return there


def write_scene_header(path: Path, header: SceneHeader) -> None:
    """Write the header into folder ``path``, whole or not at all. Raises `SceneError`, also for numbers
    that are not finite."""
    file = header_path(path)
    document = {
        "format": FORMAT,
        "version": VERSION,
        "name": header.name,
        "log": {"name": header.log_name, "path": header.log_path}
        | ({} if header.fingerprint is None else {"fingerprint": header.fingerprint.to_json()}),
        "world_origin": np.asarray(header.world_origin, np.float64).tolist(),
        "model": header.model,
        "volume": header.volume,
        "training": header.training,
        "weights": header.weights,
        "drive": drive_to_json(header.drive),
    }
    lines = []
    for key, value in document.items():
        try:
            lines.append(f" {json.dumps(key)}: {json.dumps(value, allow_nan=False)}")
        except (TypeError, ValueError) as fault:
            raise SceneError(f"{file}: {key} cannot be written as JSON: {fault}") from fault
    write_file(file, "{\n" + ",\n".join(lines) + "\n}\n", SceneError)


DTYPES = {
    "BOOL": np.bool_, "U8": np.uint8, "I8": np.int8, "U16": np.uint16, "I16": np.int16, "U32": np.uint32,
    "I32": np.int32,
    "U64": np.uint64, "I64": np.int64, "F16": np.float16, "F32": np.float32, "F64": np.float64,
}  # fmt: skip
_FORMER_PREFIX = re.compile(r"^far\.")
"""Former prefix of the names of the background model's arrays."""
LENGTH_BYTES = 8
MAX_HEADER_BYTES = 100_000_000
"""Largest size of the header of names, in bytes; safetensors' own limit."""
HALF_EXPONENT_BITS = 0x7C00
"""Bits that are all set in a half-precision number that is not finite."""


@dataclass(frozen=True)
class Weights:
    """A scene's arrays by name, read-only, of one file."""

    file: Path
    arrays: Mapping[str, NDArray[Any]]

    def array(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """Return the array of that name. Raises `SceneError` where it is missing, has another shape, or holds NaN or
        infinity."""
        self.check_shapes({name: shape})
        array = self.arrays[name]
        check_finite(self.file, name, array)
        return array

    def check_shapes(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        """Check that all these arrays are there and have these shapes. SceneError names the first that does not."""
        for name, shape in shapes.items():
            if name not in self.arrays:
                raise SceneError(f"{self.file}: {name} is missing")
            if self.arrays[name].shape != shape:
                raise SceneError(
                    f"{self.file}: {name} has shape {self.arrays[name].shape}, {HEADER_NAME} asks for {shape}"
                )

    def voxels(self, name: str, shape: tuple[int, ...]) -> NDArray[np.uint8]:
        """Return a grid of bytes, of which the file holds the numbers and values of those that are not 0. Raises
        `SceneError` as `array`."""
        index, entries = self.arrays.get(f"{name}.index"), self.arrays.get(f"{name}.value")
        if index is None or entries is None:
            raise SceneError(f"{self.file}: {name} is missing")
        whole = (
            index.ndim == 1 and index.shape == entries.shape and index.dtype.kind in "iu" and entries.dtype == np.uint8
        )
        if not whole or (len(index) and not 0 <= int(index.min()) <= int(index.max()) < math.prod(shape)):
            raise SceneError(f"{self.file}: {name} does not fit a grid of {shape} voxels")
        full = np.zeros(math.prod(shape), np.uint8)
        full[index] = entries
        return full.reshape(shape)


def read_weights(file: Path) -> Weights:
    """Return all arrays of a safetensors file. Raises `SceneError`."""
    try:
        raw = np.memmap(file, np.uint8, "c")  # the mapping is private: nothing that is written reaches the file
    except (OSError, ValueError) as fault:  # ValueError: an empty file
        raise SceneError(f"{file} cannot be read: {fault}") from fault
    if len(raw) < LENGTH_BYTES:
        _fail(file, f"it has {len(raw)} bytes, and no header")
    length = int.from_bytes(raw[:LENGTH_BYTES].tobytes(), "little")
    if length > min(len(raw) - LENGTH_BYTES, MAX_HEADER_BYTES):
        _fail(file, f"its header would be {length} bytes long, in a file of {len(raw)}")
    header = _tensor_header(file, raw[LENGTH_BYTES : LENGTH_BYTES + length].tobytes())
    data = raw[LENGTH_BYTES + length :]
    arrays, begins = {}, {}
    for name, entry in header.items():
        if name != "__metadata__":
            name = _FORMER_PREFIX.sub("background.", name)
            if name in arrays:
                _fail(file, f"it has {short(name)} twice, by a former name too")
            arrays[name], begins[name] = _array(file, name, entry, data)
    # every byte belongs to one array
    end = 0
    for name in sorted(arrays, key=lambda name: (begins[name], arrays[name].nbytes)):
        if begins[name] != end:
            _fail(file, f"{short(name)} begins at byte {begins[name]}, where the one before it ends at {end}")
        end += arrays[name].nbytes
    if end != len(data):
        _fail(file, f"its arrays take {end} bytes, of {len(data)} that are there")
    return Weights(file, arrays)


def _fail(file: Path, reason: str) -> NoReturn:
    raise SceneError(f"{file} cannot be read: {reason}")


def _tensor_header(file: Path, text: bytes) -> dict[str, Any]:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        members: dict[str, Any] = {}
        for name, value in pairs:
            if name in members:
                _fail(file, f"its header has {short(name)} twice")
            members[name] = value
        return members

    try:
        header = json.loads(text.decode(), object_pairs_hook=unique)
    except (ValueError, RecursionError) as fault:
        _fail(file, f"its header is no JSON: {short(str(fault))}")
    if not isinstance(header, dict):
        _fail(file, "its header is no JSON object")
    return header


def _array(file: Path, name: str, entry: Any, data: NDArray[np.uint8]) -> tuple[NDArray[Any], int]:
    """Return an array and its offset in the data."""
    entry = entry if isinstance(entry, dict) else {}
    kind, shape, place = entry.get("dtype"), entry.get("shape"), entry.get("data_offsets")
    if not isinstance(kind, str) or kind not in DTYPES:
        _fail(file, f"{short(name)} has dtype {short(kind)}, not one of {', '.join(DTYPES)}")
    if not _counts(shape):
        _fail(file, f"{short(name)} has shape {short(shape)}, which is no list of sizes")
    if not _counts(place) or len(place) != 2 or not place[0] <= place[1] <= len(data):
        _fail(file, f"{short(name)} lies at {short(place)}, which is no place in {len(data)} bytes")
    dtype, (begin, end) = np.dtype(DTYPES[kind]).newbyteorder("<"), place
    if math.prod(shape) * dtype.itemsize != end - begin:
        _fail(file, f"{short(name)} has {end - begin} bytes, which are no {kind} of shape {short(shape)}")
    part = data[begin:end].view(np.ndarray)
    if kind == "BOOL" and part.max(initial=0) > 1:
        _fail(file, f"{short(name)} holds {part.max()}, which is no BOOL")
    try:
        array: NDArray[Any] = part.view(dtype).reshape(shape)
    except (ValueError, OverflowError) as fault:  # more axes, or longer ones beside one of length 0, than numpy has
        _fail(file, f"{short(name)} has shape {short(shape)}: {fault}")
    if not array.flags.aligned:  # kernels read whole words
        array = array.copy().view()
    array.flags.writeable = False
    return array, begin


def _counts(value: Any) -> bool:
    return isinstance(value, list) and all(isinstance(n, int) and not isinstance(n, bool) and n >= 0 for n in value)


def check_finite(file: Path, name: str, array: NDArray[Any]) -> None:
    """Raise `SceneError`, which names the first place, where an array holds NaN or infinity."""
    if array.dtype.kind != "f":
        return
    if array.dtype == np.float16:  # numpy's own test takes four times as long on these
        broken = (array.view("<u2") & HALF_EXPONENT_BITS) == HALF_EXPONENT_BITS
    else:
        broken = ~np.isfinite(array)
    if broken.any():
        where = np.unravel_index(int(broken.argmax()), array.shape or (1,))
        raise SceneError(f"{file}: {name}{[int(i) for i in where]} is not a finite number")


def weights_hash(path: Path) -> str:
    """Return the SHA-256, in hexadecimal, of the weights of the scene in folder ``path``; cached while the file is
    unchanged."""
    file = Path(path) / WEIGHTS_NAME
    return _hash(file, file_stamp(file))


@functools.lru_cache(maxsize=64)
def _hash(file: Path, changed: tuple[int, ...]) -> str:
    return sha256_of_file(file)


def check_belongs(header: SceneHeader) -> None:
    """Raise `SceneError` where the weights beside a header are not those that it was written with."""
    if header.weights and header.weights != weights_hash(header.path):
        raise SceneError(
            f"{header.path / WEIGHTS_NAME} does not belong to the {HEADER_NAME} beside it: one of the two was written or "
            "copied without the other"
        )
