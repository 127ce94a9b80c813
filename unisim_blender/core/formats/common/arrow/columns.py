"""Columns of Arrow tables as numpy arrays, each checked for its kind."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ....errors import LogError, in_a_line, what_is_missing
from ....geometry import FloatArray, nearest_rotation

Kind = Literal["number", "whole", "text", "pose"]
"""Numbers are float64 (N,), whole numbers int64 (N,), texts str (N,), poses lists of 16 numbers, row by row, as (N, 4, 4)."""
ArrowColumns = dict[str, NDArray[Any]]
RIGID = 1e-3
"""How far from a rotation's the products of a pose's axes may be."""
ROUNDED = 1e-9
"""Those of poses that are further are made a rotation's, so that directions keep their length."""


def arrow(path: Path) -> ModuleType:
    """Return the module ``pyarrow``. Raises `LogError` naming the file that needs it, where it cannot be imported."""
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise LogError(f"{path}: {what_is_missing(error) or in_a_line(error)}") from error
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
    """Return an Arrow column as an array of its kind. Raises `LogError` naming file and column for another kind, an empty cell,
    a number that is not finite, a pose that is not rigid."""
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
    """Return the numbers (N,) of an Arrow array, chunked or not, without empty cells. Arrow's own way would import pandas."""
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
