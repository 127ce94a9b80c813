"""Arrow tables, Feather and Parquet, as JSON documents: types and values of columns by name."""

from __future__ import annotations

import io
from typing import Any


def feather_document(data: bytes) -> tuple[Any, bytes]:
    """Return the document of a Feather file, and the file."""
    import pyarrow

    return _document(pyarrow.ipc.open_file(io.BytesIO(data)).read_all()), data


def feather_file(value: tuple[Any, bytes]) -> bytes:
    """Return the Feather file of a document; ``value`` holds the file that it was, whose types are kept where values fit."""
    import pyarrow
    from pyarrow import feather

    out = io.BytesIO()
    table = _table(value[0], pyarrow.ipc.open_file(io.BytesIO(value[1])).schema)
    feather.write_feather(table, out, compression="lz4")
    return out.getvalue()


def parquet_document(data: bytes) -> tuple[Any, bytes]:
    """Return the document of a Parquet file, and the file."""
    from pyarrow import parquet

    return _document(parquet.read_table(io.BytesIO(data))), data


def parquet_file(value: tuple[Any, bytes]) -> bytes:
    """Return the Parquet file of a document, as `feather_file` does."""
    from pyarrow import parquet

    out = io.BytesIO()
    parquet.write_table(_table(value[0], parquet.read_schema(io.BytesIO(value[1]))), out, row_group_size=3)
    return out.getvalue()


def _document(table: Any) -> dict[str, Any]:
    types = {name: str(table.schema.field(name).type) for name in table.column_names}
    return {"types": types, "columns": table.to_pydict()}


def _table(document: Any, before: Any) -> Any:
    import pyarrow

    types, columns = document["types"], document["columns"]
    rows = max((len(values) for values in columns.values() if isinstance(values, list)), default=0)
    made = {}
    for name, values in columns.items():
        values = values if isinstance(values, list) else [values] * rows
        made[name] = _column(values + [None] * (rows - len(values)), types.get(name), name, before)
    return pyarrow.table(made)


def _column(values: list[Any], told: Any, name: str, before: Any) -> Any:
    """A column of the type that the document tells, or that it had, or that fits its values; of texts where none does."""
    import pyarrow

    kept = before.field(name).type if name in before.names else None
    kinds = [] if kept is not None and str(kept) == told else [told]
    for kind in (*kinds, kept, None):
        try:
            return pyarrow.array(values, pyarrow.type_for_alias(kind) if isinstance(kind, str) else kind)
        except (pyarrow.ArrowException, ValueError, TypeError, OverflowError):
            continue
    return pyarrow.array([None if value is None else str(value)[:1000] for value in values])
