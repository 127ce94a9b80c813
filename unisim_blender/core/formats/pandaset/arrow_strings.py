"""Strings as Arrow keeps them: pandas writes these where pyarrow is installed."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

OFFSETS: dict[str, np.dtype[Any]] = {
    "string": np.dtype("<i4"),
    "utf8": np.dtype("<i4"),
    "large_string": np.dtype("<i8"),
}
"""Types of strings that are read, and how each counts where its strings begin."""


def strings(kind: str, length: int, first: int, buffers: tuple[bytes | None, bytes, bytes]) -> NDArray[Any]:
    """Return the strings (length,) of an array, dtype object, None where one is missing.

    ``first``: how many elements of the buffers lie before the array's own. ``buffers``: a bit for each element, set where it is
    there, or None where all are; where each string begins, and the last ends, in bytes; the strings in UTF-8, one after another.
    From "Variable-size Binary Layout" of Arrow's columnar format. Raises ValueError where the buffers hold no such array.
    """
    present, begins, text = buffers
    size = OFFSETS[kind].itemsize
    if length < 0 or first < 0 or (length and len(begins) < size * (first + length + 1)):
        raise ValueError(f"{length} strings, and where they begin is given for others")
    if not length:
        return np.empty(0, object)
    places = np.frombuffer(begins, OFFSETS[kind], length + 1, size * first)
    if places[0] < 0 or places[-1] > len(text) or np.any(np.diff(places) < 0):
        raise ValueError("strings begin outside their text")
    there = np.ones(length, bool)
    if present is not None:
        if 8 * len(present) < first + length:
            raise ValueError(f"{length} strings, and which are there is given for others")
        there = np.unpackbits(np.frombuffer(present, np.uint8), count=first + length, bitorder="little")[first:] > 0
    values = np.empty(length, object)
    ends = places.tolist()
    values[:] = [bytes(text[a:b]).decode() if is_there else None for a, b, is_there in zip(ends, ends[1:], there)]  # noqa: B905
    return values
