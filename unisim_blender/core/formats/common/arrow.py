"""Tables of Apache Arrow's files. Needs pyarrow, an optional package that is imported where a file is read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError, in_a_line, remedy_of, what_is_missing
from ...geometry import FloatArray, nearest_rotation

MOST_ROWS = 10_000_000


def read_parquet(path: Path, columns: Mapping[str, Kind]) -> ArrowColumns:
    """Read some columns of a Parquet file; others are not read. Raises `LogError` naming the file where it is missing
    or broken, and the column where it is absent or `to_numpy` refuses it."""
    with _opened(path) as file:
        check_names(path, file.schema_arrow.names, columns)
        if file.metadata.num_rows > MOST_ROWS:
            raise LogError(f"{path}: refused, it has more than {MOST_ROWS} rows")
        table = file.read(columns=list(columns), use_threads=False)
        table.validate(full=True)
        return {name: to_numpy(path, name, table[name], kind) for name, kind in columns.items()}


def read_row(path: Path, row: int, columns: list[str]) -> dict[str, Any]:
    """Return the cells of one row as Arrow's scalars; what lies in other groups of rows is not read. Raises
    `LogError`."""
    with _opened(path) as file:
        check_names(path, file.schema_arrow.names, dict.fromkeys(columns))
        first = row
        for group in range(file.num_row_groups):
            count = file.metadata.row_group(group).num_rows
            if first < count:
                # row by row: a group may hold hundreds of megabytes
                batches = file.iter_batches(1, [group], columns, use_threads=False)
                for at, batch in enumerate(batches):
                    if at == first:
                        batch.validate(full=True)
                        return {name: batch.column(batch.schema.names.index(name))[0] for name in columns}
                break
            first -= count
    raise LogError(f"{path}: has no row {row}")


def numbers_of(path: Path, name: str, cell: Any) -> NDArray[Any]:
    """Return the numbers (K,) of a cell that holds a list, float64. Raises `LogError` for any other, and where it is
    empty."""
    pa = arrow(path)
    values = getattr(cell, "values", None)
    if values is None:
        raise LogError(f"{path}: column {name!r} holds no list of numbers where there must be one")
    return np.asarray(to_numpy(path, name, pa.chunked_array([values]), "number"))


@contextmanager
def _opened(path: Path) -> Iterator[Any]:
    pa = arrow(path)
    try:
        from pyarrow import parquet

        with parquet.ParquetFile(str(path), memory_map=False) as file:
            yield file
    except FileNotFoundError as error:
        raise LogError(f"{path}: is missing") from error
    except (pa.ArrowException, OSError, ValueError, MemoryError, OverflowError) as error:
        raise LogError(f"{path}: is no Parquet file that can be read ({in_a_line(error)})") from error


MAX_BYTES = 2**30


def read_feather(path: Path, columns: Mapping[str, Kind]) -> ArrowColumns:
    """Read some columns of a Feather file; others are not read. Raises `LogError` naming the file where it is missing,
    broken or too large, and the column where it is absent or `to_numpy` refuses it."""
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


def feather_names(path: Path) -> list[str]:
    """Return the names of a Feather file's columns; none where it cannot be read, which `read_feather` says."""
    pa = arrow(path)
    try:
        with pa.OSFile(str(path)) as source:
            return list(pa.ipc.open_file(source).schema.names)
    except (pa.ArrowException, OSError, ValueError, MemoryError, OverflowError):
        return []


def feather_bytes(columns: Mapping[str, Any]) -> bytes:
    """Return a Feather file of columns, arrays of numbers or lists of texts, each as long as the others."""
    import pyarrow as pa

    table = pa.table({name: pa.array(c, pa.string() if isinstance(c, list) else None) for name, c in columns.items()})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema, options=pa.ipc.IpcWriteOptions(compression="lz4")) as writer:
        writer.write_table(table)
    return bytes(sink.getvalue())


Kind = Literal["number", "whole", "text", "pose"]
"""Kind of a column: numbers are float64 (N,), whole numbers int64 (N,), texts str (N,), poses (N, 4, 4) float64 from
lists of 16 numbers, row by row."""
ArrowColumns = dict[str, NDArray[Any]]
RIGID = 1e-3
"""Largest difference of the products of a pose's axes from those of a rotation."""
ROUNDED = 1e-9
"""Largest such difference at which a pose is used unchanged; others get the nearest rotation, so that directions keep
their length."""


def arrow(path: Path) -> ModuleType:
    """Return the module ``pyarrow``. Raises `LogError` naming the file that needs it, where it cannot be imported."""
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise LogError(f"{path}: {what_is_missing(error) or in_a_line(error)}", remedy=remedy_of(error)) from error
    except ImportError as error:  # one built for another numpy
        raise LogError(f"{path}: this needs pyarrow, which cannot be imported: {in_a_line(error)}") from error
    return pyarrow


def check_names(path: Path, names: list[str], columns: Mapping[str, Any]) -> None:
    """Raise `LogError` where a table lacks a column, or has it twice."""
    for name in columns:
        if names.count(name) != 1:
            raise LogError(
                f"{path}: has {'no column' if name not in names else 'more than one column'} {name!r}, "
                f"but {', '.join(map(str, names[:20])) or 'none'}"
            )


def to_numpy(path: Path, name: str, column: Any, kind: Kind) -> NDArray[Any]:
    """Return an Arrow column as an array of its kind. Raises `LogError` naming file and column for another kind, an
    empty cell, a number that is not finite, a pose that is not rigid."""
    pa = arrow(path)
    types = pa.types
    if kind == "pose":
        return _poses(path, name, lists_of(path, name, column, 16).reshape(-1, 4, 4))
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
    """Return the numbers (N,) of an Arrow array, chunked or not, without empty cells. Arrow's own way would import
    pandas."""
    chunks = getattr(column, "chunks", [column])
    dtype = np.dtype({"halffloat": "f2", "float": "f4", "double": "f8"}.get(str(column.type), str(column.type)))
    parts = [np.frombuffer(c.buffers()[1], dtype, len(c), c.offset * dtype.itemsize) for c in chunks if len(c)]
    return np.concatenate(parts) if parts else np.zeros(0, dtype)


def stacked(table: ArrowColumns, names: tuple[str, ...]) -> FloatArray:
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


def lists_of(path: Path, name: str, column: Any, width: int) -> FloatArray:
    """Return a column of lists of ``width`` numbers each as float64 (N, width). Raises `LogError`; see `to_numpy`."""
    pa = arrow(path)
    types = pa.types
    if not (types.is_list(column.type) or types.is_large_list(column.type) or types.is_fixed_size_list(column.type)):
        raise LogError(f"{path}: column {name!r} holds {column.type}, not lists of numbers")
    if column.null_count:
        raise LogError(f"{path}: column {name!r} has {column.null_count} empty cells")
    lengths = [len(part) for chunk in column.chunks for part in chunk]
    wrong = next((row for row, length in enumerate(lengths) if length != width), None)
    if wrong is not None:
        raise LogError(f"{path}: row {wrong} of column {name!r} has {lengths[wrong]} numbers, not {width}")
    parts = [to_numpy(path, name, pa.chunked_array([chunk.flatten()]), "number") for chunk in column.chunks]
    return np.concatenate(parts).reshape(-1, width) if parts else np.zeros((0, width))


def _poses(path: Path, name: str, poses: FloatArray) -> FloatArray:
    axes = poses[:, :3, :3]
    off = np.abs(axes @ axes.swapaxes(1, 2) - np.eye(3)).reshape(len(poses), 9).max(1, initial=0.0)
    wrong = (off > RIGID) | (np.linalg.det(axes) < 0) | (np.abs(poses[:, 3] - [0, 0, 0, 1]) > RIGID).any(1)
    if wrong.any():
        raise LogError(f"{path}: row {int(wrong.argmax())} of column {name!r} is no rotation and place")
    loose = off > ROUNDED
    if loose.any():
        poses = poses.copy()
        poses[loose, :3, :3] = nearest_rotation(axes[loose])
    return poses
