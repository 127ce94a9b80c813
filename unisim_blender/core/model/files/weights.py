"""`weights.safetensors`, the other half of a trained scene, as arrays that lie where the file is mapped:
nothing is copied.

The format is safetensors': eight bytes, little-endian, say how long a JSON object is that names every array's dtype,
shape and place in the bytes behind it. What does not keep to it raises `SceneError`, naming the file and the value.
"""

from __future__ import annotations

import functools
import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from ...errors import SceneError, short
from ...files import file_stamp, sha256_of_file
from .scene_file import HEADER_NAME, WEIGHTS_NAME, SceneHeader

DTYPES = {
    "BOOL": np.bool_, "U8": np.uint8, "I8": np.int8, "U16": np.uint16, "I16": np.int16, "U32": np.uint32,
    "I32": np.int32,
    "U64": np.uint64, "I64": np.int64, "F16": np.float16, "F32": np.float32, "F64": np.float64,
}  # fmt: skip
_FORMER = re.compile(r"^far\.")
"""Former prefix of the names of the background model's arrays."""
LENGTH_BYTES = 8
MOST_HEADER_BYTES = 100_000_000
"""Of the names; safetensors' own limit."""
HALF_EXPONENT = 0x7C00
"""The bits that are all set in a half-precision number that is not finite."""


@dataclass(frozen=True)
class Weights:
    """A scene's arrays by name, read-only, of one file."""

    file: Path
    arrays: Mapping[str, NDArray[Any]]

    def array(self, name: str, shape: tuple[int, ...]) -> NDArray[Any]:
        """The array of that name. SceneError where it is missing, has another shape, or holds NaN or infinity."""
        self.check_shapes({name: shape})
        found = self.arrays[name]
        check_finite(self.file, name, found)
        return found

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
        """A grid of bytes, of which the file holds the numbers and values of those that are not 0.
        SceneError as `array`."""
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
    """All arrays of a safetensors file. Raises `SceneError`."""
    try:
        raw = np.memmap(file, np.uint8, "c")  # the mapping is private: nothing that is written reaches the file
    except (OSError, ValueError) as fault:  # ValueError: an empty file
        raise SceneError(f"{file} cannot be read: {fault}") from fault
    if len(raw) < LENGTH_BYTES:
        _fail(file, f"it has {len(raw)} bytes, and no header")
    length = int.from_bytes(raw[:LENGTH_BYTES].tobytes(), "little")
    if length > min(len(raw) - LENGTH_BYTES, MOST_HEADER_BYTES):
        _fail(file, f"its header would be {length} bytes long, in a file of {len(raw)}")
    header = _header(file, raw[LENGTH_BYTES : LENGTH_BYTES + length].tobytes())
    data = raw[LENGTH_BYTES + length :]
    arrays, begins = {}, {}
    for name, entry in header.items():
        if name != "__metadata__":
            name = _FORMER.sub("background.", name)
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


def _header(file: Path, text: bytes) -> dict[str, Any]:
    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for name, value in pairs:
            if name in found:
                _fail(file, f"its header has {short(name)} twice")
            found[name] = value
        return found

    try:
        header = json.loads(text.decode(), object_pairs_hook=unique)
    except (ValueError, RecursionError) as fault:
        _fail(file, f"its header is no JSON: {short(str(fault))}")
    if not isinstance(header, dict):
        _fail(file, "its header is no JSON object")
    return header


def _array(file: Path, name: str, entry: Any, data: NDArray[np.uint8]) -> tuple[NDArray[Any], int]:
    """An array and where in the data it begins."""
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
    """SceneError where an array holds NaN or infinity, naming the first place."""
    if array.dtype.kind != "f":
        return
    if array.dtype == np.float16:  # numpy's own test takes four times as long on these
        broken = (array.view("<u2") & HALF_EXPONENT) == HALF_EXPONENT
    else:
        broken = ~np.isfinite(array)
    if broken.any():
        where = np.unravel_index(int(broken.argmax()), array.shape or (1,))
        raise SceneError(f"{file}: {name}{[int(i) for i in where]} is not a finite number")


def weights_hash(path: Path) -> str:
    """SHA-256 of the weights of the scene in folder ``path``, in hexadecimal; of a file that did not change,
    worked out once."""
    file = Path(path) / WEIGHTS_NAME
    return _hash(file, file_stamp(file))


@functools.lru_cache(maxsize=64)
def _hash(file: Path, changed: tuple[int, ...]) -> str:
    return sha256_of_file(file)


def check_belongs(header: SceneHeader) -> None:
    """SceneError where the weights beside a header are not those that it was written with."""
    if header.weights and header.weights != weights_hash(header.path):
        raise SceneError(
            f"{header.path / WEIGHTS_NAME} does not belong to the {HEADER_NAME} beside it: one of the two was written or "
            "copied without the other"
        )
