"""Files of points, rows of float32 numbers, as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np


def rows_of(data: bytes, width: int) -> dict[str, Any]:
    """Return the array (N, width) of a file, named "points"."""
    return {"points": np.frombuffer(data, "<f4").reshape(-1, width).copy()}


def file_of(arrays: dict[str, Any]) -> bytes:
    """Return the file of the array named "points", as it lies in memory."""
    return np.ascontiguousarray(arrays.get("points", np.zeros(0, "<f4"))).tobytes()
