"""Stores of a sequence, opened and checked: what NCore's package would trust is looked at before.

Arrays are decoded by `read_array` alone: a zarr array may name a codec that unpickles, and may lack the chunks that it promises.
"""

from __future__ import annotations

import lzma
import struct
import tarfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError, UnisimError, in_a_line
from ...json_file import Node, read_json
from .layout import is_store, stores_beside

MOST_BYTES = 1 << 28
"""Of a store's index, and of one array, unpacked."""
CODECS = {"blosc", "lz4", "zlib", "zstd", "gzip"}
"""Codecs that only unpack bytes."""
INDEX = struct.Struct("<4sIQI")
"""The last block of a .itar file: "itar", a type, and the offset and size of its index."""


@contextmanager
def told(path: Path | str, what: str = "cannot be read") -> Iterator[None]:
    """Turn whatever NCore's package and zarr raise at a broken file into one `LogError` that names it."""
    try:
        yield
    except (UnisimError, ModuleNotFoundError):
        raise
    except Exception as fault:  # noqa: BLE001  the libraries assert, and pass on what theirs raise
        raise LogError(f"{path}: {what} ({in_a_line(fault)})") from fault


def sequence_stores(path: Path) -> list[Path]:
    """Return the stores of a sequence: those that its JSON file lists, or else those beside it. Raises `LogError`."""
    stores = stores_beside(path)
    document = path if path.suffix == ".json" else _document(stores)
    if document is not None:
        node = Node(read_json(document, LogError), f"{document}: ", LogError)
        listed = [(one.key("path"), one.key("path").text()) for one in node.key("component_stores").elements()]
        for place, name in listed:
            if Path(name).name != name or not is_store(Path(name)):
                place.fail(f"must be the name of a store beside the file, not {name!r:.80}")
            if not (document.parent / name).exists():
                raise LogError(f"{document.parent / name}: is missing; {document.name} lists it")
        stores = [document.parent / name for _, name in listed]
    if not stores:
        raise LogError(f"{path}: has no stores")
    return stores


def check_index(path: Path) -> int | None:
    """Check that a .itar file ends with an index that unpacks to a size that can be held, and return where the index begins; None
    for a store that is a folder. Raises `LogError`."""
    if path.is_dir():
        return None
    try:
        size = path.stat().st_size
        with path.open("rb") as stream:
            stream.seek(max(0, size - tarfile.BLOCKSIZE))
            block = stream.read(INDEX.size)
            if len(block) < INDEX.size or block[:4] != b"itar":
                raise LogError(f"{path}: is cut off or no store: it does not end with an index")
            _, _, offset, packed = INDEX.unpack(block)
            if offset + packed > size:
                raise LogError(f"{path}: is cut off: its index lies beyond its end")
            stream.seek(offset)
            unpacker = lzma.LZMADecompressor()
            unpacker.decompress(stream.read(packed), max_length=MOST_BYTES)
    except OSError as fault:
        raise LogError(f"{path}: cannot be read ({fault.strerror})") from fault
    except (lzma.LZMAError, EOFError) as fault:
        raise LogError(f"{path}: its index is broken ({in_a_line(fault)})") from fault
    if not unpacker.eof:
        raise LogError(f"{path}: its index is broken or too large: it does not end within {MOST_BYTES >> 20} MiB")
    return int(offset)


def read_array(array: Any, path: Path, where: str, kinds: str) -> NDArray[Any]:
    """Return a zarr array's values, of a dtype of one of the ``kinds``. Raises `LogError` naming the store and the place."""
    with told(path, f"{where} cannot be read"):
        if array.dtype.kind not in kinds or array.nbytes > MOST_BYTES:
            raise LogError(f"{path}: {where} is {array.dtype} {array.shape}, which is refused")
        codec = None if array.compressor is None else array.compressor.codec_id
        if array.filters or not (codec is None or codec in CODECS):
            raise LogError(f"{path}: {where} is packed in a way that is refused")
        for chunk in np.ndindex(*array.cdata_shape):
            key = f"{array.path}/{'.'.join(map(str, chunk)) or '0'}"
            if key not in array.chunk_store:
                raise LogError(f"{path}: {where} lacks its part {key.rpartition('/')[2]}")
        return np.asarray(array[...])


def _document(stores: list[Path]) -> Path | None:
    """The sequence's JSON file beside its stores, where there is one."""
    for store in stores:
        beside = store.parent / f"{store.name.partition('.ncore4')[0]}.json"
        if beside.is_file():
            return beside
    return None
