"""NCore's stores: the index and the descriptions in a .itar file as JSON documents, the unpacked parts of arrays."""

from __future__ import annotations

import io
import json
import lzma
import struct
from typing import Any

HEADER = struct.Struct("<4sIQI")
BLOCK = 512


def index_of(data: bytes) -> tuple[Any, bytes]:
    """Return names, offsets and sizes of a .itar file's parts, and what lies before its index."""
    import cbor2

    _, _, offset, size = HEADER.unpack(data[-BLOCK : -BLOCK + HEADER.size])
    document = cbor2.loads(lzma.decompress(data[offset : offset + size]))
    return {name: list(values) for name, values in document.items()}, data[:offset]


def with_index(value: tuple[Any, bytes]) -> bytes:
    """Return the .itar file of an index and what lies before it."""
    import cbor2

    document, before = value
    packed = lzma.compress(cbor2.dumps(document))
    padded = packed + b"\0" * (-len(packed) % BLOCK)
    return before + padded + HEADER.pack(b"itar", 1, len(before), len(packed)).ljust(BLOCK, b"\0")


def unpacked(data: bytes) -> bytes:
    """Return what a part of an array holds, which blosc packed."""
    from numcodecs import blosc

    return bytes(blosc.decompress(data))


def packed(data: bytes) -> bytes:
    """Return a part of an array, packed."""
    from numcodecs import Blosc

    return bytes(Blosc().encode(io.BytesIO(data).getbuffer()))


def parts_of(data: bytes) -> tuple[Any, bytes]:
    """Return what the parts of a .itar file say that are JSON, by their names, and the file."""
    index, before = index_of(data)
    rows = zip(index["items"], index["offset_datas"], index["sizes"], strict=True)
    texts = {name: before[at : at + size] for name, at, size in rows if _is_json(name)}
    return {name: json.loads(text) for name, text in texts.items()}, data


def with_parts(value: tuple[Any, bytes]) -> bytes:
    """Return the .itar file in which parts say something else, or are not there."""
    document, data = value
    index, before = index_of(data)
    found: dict[str, list[Any]] = {"items": [], "offset_datas": [], "sizes": []}
    kept = zip(index["items"], index["offset_datas"], index["sizes"], strict=True)
    parts = {name: before[at : at + size] for name, at, size in kept if not _is_json(name)}
    parts |= {name: json.dumps(part).encode() for name, part in document.items()}
    body = bytearray()
    for name, part in parts.items():
        found["items"].append(name)
        found["offset_datas"].append(len(body))
        found["sizes"].append(len(part))
        body += part
    return with_index((found, bytes(body)))


def _is_json(name: str) -> bool:
    return name.rpartition("/")[2] in (".zattrs", ".zgroup", ".zarray")
