"""Parquet files: whole small tables, and single rows of large ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....errors import LogError, in_a_line
from .columns import ArrowColumns, Kind, arrow, check_names, to_numpy

MOST_ROWS = 10_000_000


def read_parquet(path: Path, columns: Mapping[str, Kind]) -> ArrowColumns:
    """Read some columns of a Parquet file; others are not read. Raises `LogError` naming the file where it is missing or broken,
    and the column where it is absent or `to_numpy` refuses it."""
    with _opened(path) as file:
        check_names(path, file.schema_arrow.names, columns)
        if file.metadata.num_rows > MOST_ROWS:
            raise LogError(f"{path}: refused, it has more than {MOST_ROWS} rows")
        table = file.read(columns=list(columns), use_threads=False)
        table.validate(full=True)
        return {name: to_numpy(path, name, table[name], kind) for name, kind in columns.items()}


def has_columns(path: Path, names: list[str]) -> bool:
    """Return whether a Parquet file has all of some columns. Raises `LogError`."""
    with _opened(path) as file:
        return set(names) <= set(file.schema_arrow.names)


def read_row(path: Path, row: int, columns: list[str]) -> dict[str, Any]:
    """Return the cells of one row as Arrow's scalars; what lies in other groups of rows is not read. Raises `LogError`."""
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
    """Return the numbers (K,) of a cell that holds a list, float64. Raises `LogError` for any other, and where it is empty."""
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
