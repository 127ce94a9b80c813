"""Feather files (Arrow IPC)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ....errors import LogError, in_a_line
from .columns import ArrowColumns, Kind, arrow, check_names, to_numpy

MAX_BYTES = 2**30


def read_feather(path: Path, columns: Mapping[str, Kind]) -> ArrowColumns:
    """Read some columns of a Feather file; others are not read. Raises `LogError` naming the file where it is missing, broken or
    too large, and the column where it is absent or `to_numpy` refuses it."""
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


def feather_bytes(columns: Mapping[str, Any]) -> bytes:
    """Return a Feather file of columns, arrays of numbers or lists of texts, each as long as the others."""
    import pyarrow as pa

    table = pa.table({name: pa.array(c, pa.string() if isinstance(c, list) else None) for name, c in columns.items()})
    sink = pa.BufferOutputStream()
    with pa.ipc.new_file(sink, table.schema, options=pa.ipc.IpcWriteOptions(compression="lz4")) as writer:
        writer.write_table(table)
    return bytes(sink.getvalue())
