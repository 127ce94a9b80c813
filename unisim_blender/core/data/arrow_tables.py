"""Tables of Arrow IPC files (Feather) as numpy arrays, each column checked for its kind. Needs pyarrow, an optional package."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import LogError, in_a_line, what_is_missing
from ..geometry import FloatArray

Kind = Literal["number", "whole", "text"]
Columns = dict[str, NDArray[Any]]
MAX_BYTES = 2**30


def arrow(path: Path) -> ModuleType:
    """Return the module ``pyarrow``. Raises `LogError` naming the file that needs it, where it cannot be imported."""
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise LogError(f"{path}: {what_is_missing(error) or in_a_line(error)}") from error
    except ImportError as error:  # one built for another numpy
        raise LogError(f"{path}: this needs pyarrow, which cannot be imported: {in_a_line(error)}") from error
    return pyarrow


def read_feather(path: Path, columns: Mapping[str, Kind]) -> Columns:
    """Read some columns (N,) of a Feather file: numbers as float64, whole numbers as int64, texts as str.

    Other columns are not read. Raises `LogError` naming file and column for a file that is missing, broken or too large, a column
    that is absent or of another kind, an empty cell and a number that is not finite.
    """
    pa = arrow(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise LogError(f"{path}: refused, it has more than {MAX_BYTES // 2**20} MiB")
        with pa.OSFile(str(path)) as source:
            names = pa.ipc.open_file(source).schema.names
            check_names(path, names, columns)
            options = pa.ipc.IpcReadOptions(
                included_fields=sorted({names.index(name) for name in columns}), use_threads=False
            )
            table = pa.ipc.open_file(source, options=options).read_all()
            table.validate(full=True)
        return {name: to_numpy(path, name, table[name], kind) for name, kind in columns.items()}
    except FileNotFoundError as error:
        raise LogError(f"{path}: is missing") from error
    except (pa.ArrowException, OSError, ValueError, MemoryError, OverflowError) as error:
        raise LogError(f"{path}: is no Feather file that can be read ({in_a_line(error)})") from error


def check_names(path: Path, names: list[str], columns: Mapping[str, Any]) -> None:
    """Raise `LogError` where a table lacks a column, or has it twice."""
    for name in columns:
        if names.count(name) != 1:
            raise LogError(
                f"{path}: has {'no column' if name not in names else 'more than one column'} {name!r}, "
                f"but {', '.join(map(str, names[:20])) or 'none'}"
            )


def to_numpy(path: Path, name: str, column: Any, kind: Kind) -> NDArray[Any]:
    """Return an Arrow column as an array (N,) of its kind; see `read_feather`."""
    pa = arrow(path)
    types = pa.types
    if column.null_count:
        raise LogError(f"{path}: column {name!r} has {column.null_count} empty cells")
    if kind == "text":
        if not (types.is_string(column.type) or types.is_large_string(column.type)):
            raise LogError(f"{path}: column {name!r} holds {column.type}, not text")
        texts = np.empty(len(column), object)
        texts[:] = column.to_pylist()
        return texts
    whole = types.is_integer(column.type)
    if not whole and (kind == "whole" or not types.is_floating(column.type)):
        wanted = "whole numbers" if kind == "whole" else "numbers"
        raise LogError(f"{path}: column {name!r} holds {column.type}, not {wanted}")
    if kind == "whole":
        return values_of(column.cast(pa.int64()))
    numbers = values_of(column).astype(np.float64)
    finite = np.isfinite(numbers)
    if not finite.all():
        row = int(finite.argmin())
        raise LogError(f"{path}: row {row} of column {name!r} is {numbers[row]}")
    return numbers


def values_of(column: Any) -> NDArray[Any]:
    """Return the numbers (N,) of an Arrow array, chunked or not, without empty cells. Arrow's own way would import pandas."""
    chunks = getattr(column, "chunks", [column])
    dtype = np.dtype({"halffloat": "f2", "float": "f4", "double": "f8"}.get(str(column.type), str(column.type)))
    parts = [np.frombuffer(c.buffers()[1], dtype, len(c), c.offset * dtype.itemsize) for c in chunks if len(c)]
    return np.concatenate(parts) if parts else np.zeros(0, dtype)


def stacked(table: Columns, names: tuple[str, ...]) -> FloatArray:
    """Return number columns side by side (N, len(names))."""
    return np.stack([table[name] for name in names], -1).astype(np.float64)


def unit_quaternions(path: Path, quaternions: FloatArray) -> FloatArray:
    """Return quaternions (N, 4) at length 1. Raises `LogError` for one that is further from it than rounding."""
    lengths = np.linalg.norm(quaternions, axis=-1)
    wrong = np.abs(lengths - 1) > 1e-3
    if wrong.any():
        row = int(wrong.argmax())
        raise LogError(f"{path}: the quaternion of row {row} has length {lengths[row]:.6g}, not 1")
    return quaternions / lengths[..., None]
