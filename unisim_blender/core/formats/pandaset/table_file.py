"""Writes a table as the gzipped pickle of a pandas.DataFrame, without pandas; pandas 0.25 to 3 read it.

The pickle is put together from its instructions, in the form that pandas 0.25 wrote: a class is only its name there.
Equal tables give equal bytes.
"""

from __future__ import annotations

import gzip
import pickle
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...files import write_file
from .safe_pickle import PickledTable

_RECONSTRUCTED = b"cnumpy.core.multiarray\n_reconstruct\n"
_NDARRAY = b"cnumpy\nndarray\n"
_DTYPE = b"cnumpy\ndtype\n"
_FRAME = b"cpandas.core.frame\nDataFrame\n"
_MANAGER = b"cpandas.core.internals.managers\nBlockManager\n"
_NEW_INDEX = b"cpandas.core.indexes.base\n_new_Index\n"
_INDEX = b"cpandas.core.indexes.base\nIndex\n"
_RANGE = b"cpandas.core.indexes.range\nRangeIndex\n"
_SLICE = b"cbuiltins\nslice\n"
_CALL, _NEW, _BUILD = b"R", b"\x81", b"b"

COMPRESSION = 6


def write_table(path: Path, table: PickledTable) -> None:
    """Write columns (N,) by name: numbers and booleans as they are, everything else as Python objects
    (str, float nan)."""
    write_file(path, gzip.compress(table_pickle(table), COMPRESSION, mtime=0))


def table_pickle(table: PickledTable) -> bytes:
    """The pickle of the table, protocol 3."""
    rows = len(next(iter(table.values()))) if table else 0
    labels = _tuple(_INDEX, _dict({"data": _array(np.array(list(table), object)), "name": _plain(None)}))
    limits = {"name": None, "start": 0, "stop": rows, "step": 1}
    row_index = _tuple(_RANGE, _dict({key: _plain(value) for key, value in limits.items()}))
    axes = _list(_NEW_INDEX + labels + _CALL, _NEW_INDEX + row_index + _CALL)
    blocks = _list(
        *(
            _dict({"values": _array(np.asarray(column)[None]), "mgr_locs": _SLICE + _plain((i, i + 1, 1)) + _CALL})
            for i, column in enumerate(table.values())
        )
    )
    content = _dict({"0.14.1": _dict({"axes": axes, "blocks": blocks})})
    manager = _MANAGER + b")" + _NEW + _tuple(axes, _plain([]), _plain([]), content) + _BUILD
    state = _dict({"_data": manager, "_typ": _plain("dataframe"), "_metadata": _plain([])})
    return b"\x80\x03" + _FRAME + b")" + _NEW + state + _BUILD + b"."


def _array(array: NDArray[Any]) -> bytes:
    """Instructions that leave a numpy array."""
    empty = _RECONSTRUCTED + _tuple(_NDARRAY, _plain((0,)), _plain(b"b")) + _CALL
    if array.dtype.kind in "biuf":
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        order = "|" if little.dtype.itemsize == 1 else "<"
        kind, data = _dtype(little.dtype.kind + str(little.dtype.itemsize), order, 0), _plain(little.tobytes())
    else:
        kind, data = _dtype("O8", "|", 63), _plain(array.ravel().tolist())
    return empty + _tuple(_plain(1), _plain(array.shape), kind, _plain(False), data) + _BUILD


def _dtype(code: str, order: str, flags: int) -> bytes:
    return _DTYPE + _plain((code, False, True)) + _CALL + _plain((3, order, None, None, None, -1, -1, flags)) + _BUILD


def _plain(value: Any) -> bytes:
    """Instructions that leave a value of built-in types alone."""
    return pickle.dumps(value, 3)[2:-1]


def _tuple(*parts: bytes) -> bytes:
    return b"(" + b"".join(parts) + b"t"


def _list(*parts: bytes) -> bytes:
    return b"](" + b"".join(parts) + b"e"


def _dict(parts: dict[str, bytes]) -> bytes:
    return b"}(" + b"".join(_plain(key) + part for key, part in parts.items()) + b"u"
