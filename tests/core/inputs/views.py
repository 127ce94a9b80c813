"""How a file is opened for a fault and closed again: as bytes, as JSON, as arrays by name."""

from __future__ import annotations

import gzip
import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from inputs.datasets import points, stores, tables, texts
from inputs.faults import Fault
from unisim_blender.core.formats.pandaset.safe_pickle import _Machine, _table
from unisim_blender.core.formats.pandaset.write import table_pickle
from unisim_blender.core.model.scene_file import DTYPES

CODES = {np.dtype(kind): code for code, kind in DTYPES.items()}


def json_text(value: Any) -> bytes:
    """Return JSON as a file has it; texts may be none, numbers not finite."""
    return json.dumps(value).encode("utf-8", "surrogatepass")


def npz_arrays(data: bytes) -> dict[str, Any]:
    """Return the arrays of an NPZ file."""
    with np.load(io.BytesIO(data), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def npz_file(arrays: dict[str, Any]) -> bytes:
    """Return an NPZ file; members that are no arrays become some, pickled where nothing else holds them."""
    file = io.BytesIO()
    np.savez(file, **{name.replace("\0", "0") or "_": value for name, value in arrays.items()})
    return file.getvalue()


def npy_array(data: bytes) -> dict[str, Any]:
    """Return the array of an NPY file, named "array"."""
    return {"array": np.load(io.BytesIO(data), allow_pickle=False)}


def npy_file(arrays: dict[str, Any]) -> bytes:
    """Return the NPY file of the array named "array"."""
    file = io.BytesIO()
    np.save(file, arrays.get("array", 0))
    return file.getvalue()


def _split(data: bytes) -> tuple[Any, bytes]:
    end = 8 + int.from_bytes(data[:8], "little")
    return json.loads(data[8:end]), data[end:]


def tensors(data: bytes) -> dict[str, Any]:
    """Return the arrays of a safetensors file; "__metadata__" is its texts."""
    header, body = _split(data)
    found: dict[str, Any] = {"__metadata__": header.get("__metadata__", {})}
    for name, told in header.items():
        if name != "__metadata__":
            begin, end = told["data_offsets"]
            found[name] = np.frombuffer(body[begin:end], DTYPES[told["dtype"]]).reshape(told["shape"]).copy()
    return found


def tensor_file(values: dict[str, Any]) -> bytes:
    """Return a safetensors file of arrays; what the format has no type for is left out."""
    header, body = {}, b""
    for name, value in values.items():
        array = np.asarray(value) if not isinstance(value, dict | str) else None
        if name == "__metadata__":
            header[name] = value
        elif array is not None and array.dtype in CODES:
            raw = np.ascontiguousarray(array).tobytes()
            offsets = [len(body), len(body) + len(raw)]
            header[name] = {"dtype": CODES[array.dtype], "shape": list(array.shape), "data_offsets": offsets}
            body += raw
    text = json_text(header)
    return len(text).to_bytes(8, "little") + text + body


def _header_file(value: tuple[Any, bytes]) -> bytes:
    text = json_text(value[0])
    return len(text).to_bytes(8, "little") + text + value[1]


def _table_columns(data: bytes) -> dict[str, Any]:
    return {name: np.array(column) for name, column in _table(_Machine().run(gzip.decompress(data))).items()}


def _torch_pickle(data: bytes) -> tuple[bytes, bytes]:
    """Return the pickle in a file of torch's, which is a zip file, and the file."""
    with zipfile.ZipFile(io.BytesIO(data)) as file:
        (name,) = (name for name in file.namelist() if name.endswith("data.pkl"))
        return file.read(name), data


def _torch_file(value: tuple[bytes, bytes]) -> bytes:
    pickled, data = value
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as file, zipfile.ZipFile(out, "w") as made:
        for name in file.namelist():
            made.writestr(name, pickled if name.endswith("data.pkl") else file.read(name))
    return out.getvalue()


def _gltf(data: bytes) -> tuple[Any, bytes]:
    length = int.from_bytes(data[12:16], "little")
    return json.loads(data[20 : 20 + length]), data


def _gltf_file(value: tuple[Any, bytes]) -> bytes:
    told, data = value
    text = json_text(told)
    text += b" " * (-len(text) % 4)
    rest = data[20 + int.from_bytes(data[12:16], "little") :]
    size = (20 + len(text) + len(rest)).to_bytes(4, "little")
    return data[:8] + size + len(text).to_bytes(4, "little") + data[16:20] + text + rest


def _messages(data: bytes) -> list[Any]:
    stream, found = io.BytesIO(data), []
    while head := stream.read(4):
        found.append(json.loads(stream.read(int.from_bytes(head, "little"))))
    return found


def message_stream(messages: list[Any]) -> bytes:
    """Return messages as they go through the worker's pipe."""
    texts = [json_text(message) for message in messages]
    return b"".join(len(text).to_bytes(4, "little") + text for text in texts)


View = tuple[Callable[[bytes], Any], Callable[[Any], bytes]]
VIEWS: dict[str, View] = {
    "bytes": (bytes, bytes),
    "json": (json.loads, json_text),
    "unzipped": (gzip.decompress, lambda data: gzip.compress(data, 1)),
    "table": (_table_columns, lambda table: gzip.compress(table_pickle(table), 1)),
    "npz": (npz_arrays, npz_file),
    "npy": (npy_array, npy_file),
    "tensors": (tensors, tensor_file),
    "messages": (_messages, message_stream),
    "words": (texts.lines_of_words, texts.text_of_lines),
    "tags": (texts.tags_of, texts.text_of_tags),
    "points of 4": (lambda data: points.rows_of(data, 4), points.file_of),
    "points of 5": (lambda data: points.rows_of(data, 5), points.file_of),
    "unpacked": (stores.unpacked, stores.packed),
}
PAIRED: dict[str, tuple[Callable[[bytes], tuple[Any, bytes]], Callable[[Any], bytes]]] = {
    "tensor names": (_split, _header_file),
    "gltf": (_gltf, _gltf_file),
    "torch pickle": (_torch_pickle, _torch_file),
    "feather": (tables.feather_document, tables.feather_file),
    "parquet": (tables.parquet_document, tables.parquet_file),
    "index": (stores.index_of, stores.with_index),
    "parts": (stores.parts_of, stores.with_parts),
}
"""Views of a part of a file: of a JSON document, of a pickle."""


@dataclass(frozen=True)
class In:
    """Faults of one file, in their order, seen through a view. Without a view the file is not there at all."""

    file: str
    view: str
    faults: tuple[Fault, ...] = ()

    def applied(self, data: bytes) -> bytes:
        """Return the file with its faults; as it was where the view cannot show it (another fault broke it)."""
        try:
            if self.view in PAIRED:
                opened, closed = PAIRED[self.view]
                document, rest = opened(data)
                for fault in self.faults:
                    document = fault.applied(document)
                return closed((document, rest))
            value = VIEWS[self.view][0](data)
            for fault in self.faults:
                value = fault.applied(value)
            return VIEWS[self.view][1](value)
        except Exception:  # whatever readers and writers of views raise at a file that is broken already
            return data


def whole_document(data: bytes, view: str) -> Any:
    """Return what faults of a view are drawn for."""
    return PAIRED[view][0](data)[0] if view in PAIRED else VIEWS[view][0](data)
