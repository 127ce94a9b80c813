"""Random changes: of JSON values, of bytes, and of arrays."""

from __future__ import annotations

import copy
import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

Random = np.random.Generator

ODD: tuple[Any, ...] = (
    None, True, False, 0, -1, 1, 2, 7, 0.5, -0.0, 1e-320, 1e-9, 1e9, 1e30, -1e308, 1e308, 2**31, 2**53, -(2**63), 10**40,
    float("nan"), float("inf"), float("-inf"), "", "x", "nan", "../..", "/", "\0", "\ud800", "y" * 5000, "car", "front",
    [], {}, [[]], [0], [1e308] * 3, [0, 0, 0], [0, 0, 0, 0], [1, 2], [None] * 3, ["a"] * 3, [[1, 2, 3]], {"a": 1},
)  # fmt: skip
"""Values that are put in the place of others."""
BYTES = (0, 1, 0x7F, 0x80, 0xFF, 0x0A, 0x22, 0x2D, 0x30, 0x39)
MANY = (2, 3, 100, 3000, 100_000)
"""So often a member of a list is repeated."""
MOST_MEMBERS = 200_000
"""No document grows beyond this: files of any size take a time of their own to be parsed."""


def _places(value: Any, found: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """All members of a JSON value: what holds them, and under which key."""
    for key, member in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        found.append((value, key))
        _places(member, found)
    return found


def changed_json(value: Any, rng: Random) -> Any:
    """A JSON value with one to three members changed."""
    value = copy.deepcopy(value)
    for _ in range(int(rng.integers(1, 4))):
        places = _places(value, [])
        if not places:
            return ODD[rng.integers(len(ODD))]
        holder, key = places[rng.integers(len(places))]
        kind = int(rng.integers(8))
        if kind == 0:
            del holder[key]
        elif kind == 1 and isinstance(holder, list):
            room = MOST_MEMBERS - len(places)
            size = 1 + len(_places(holder[key], [])) + len(json.dumps(holder[key])) // 20
            count = max(0, min(MANY[rng.integers(len(MANY))], room // size))
            # copies, for one that is shared would grow everywhere at once
            holder[key:key] = [copy.deepcopy(holder[key]) for _ in range(count)]
        elif kind == 2 and isinstance(holder[key], int | float) and not isinstance(holder[key], bool):
            factor = (-1, 0.5, 2, 10, 1e3, 1e6, 1e12, 1 + 1e-12)[rng.integers(8)]
            holder[key] = type(holder[key])(holder[key] * factor)
        elif kind == 3 and isinstance(holder, list):
            del holder[key:]
        elif kind == 4 and len(places) < 10_000:
            other_holder, other = places[rng.integers(len(places))]
            holder[key] = copy.deepcopy(other_holder[other])
        elif kind == 5 and isinstance(holder, dict):
            holder[str(rng.choice(["x", "", "type", "actor", "\0"]))] = holder[key]
        else:
            holder[key] = copy.deepcopy(ODD[rng.integers(len(ODD))])
    return value


def json_text(value: Any, rng: Random) -> bytes:
    """A JSON value's text, now and then broken: a key twice, nested beyond bounds, cut off, not UTF-8."""
    text = json.dumps(value).encode("utf-8", "surrogatepass")
    kind = int(rng.integers(40))
    if kind == 0:
        return text[: int(rng.integers(len(text) + 1))]
    if kind == 1:
        return b"[" * 100_000
    if kind == 2:
        return changed_bytes(text, rng)
    if kind == 3 and text.startswith(b"{") and len(text) > 2:
        return b'{"format": 1, ' + text[1:]
    if kind == 4:
        return b"9" * 5000
    return text


def changed_bytes(data: bytes, rng: Random) -> bytes:
    """Bytes with one to four runs of them changed, taken out, doubled or added."""
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        # the start of a file is where its structure is
        end = len(out) if rng.random() < 0.5 else min(len(out), 200)
        at, kind = int(rng.integers(max(end, 1))), int(rng.integers(7))
        length = int(2 ** rng.uniform(0, 6))
        if kind == 0:
            out[at : at + 1] = bytes([int(rng.integers(256))])
        elif kind == 1:
            out[at : at + 1] = bytes([BYTES[rng.integers(len(BYTES))]])
        elif kind == 2:
            del out[at : at + length]
        elif kind == 3:
            out[at:at] = out[at : at + length]
        elif kind == 4:
            out[at:at] = rng.bytes(length)
        elif kind == 5:
            out[at : at + 4] = int(rng.choice([0, 2**31 - 1, 2**32 - 1, 2**24])).to_bytes(4, "little")
        else:
            del out[at:]
    return bytes(out)


def changed_array(array: NDArray[Any], rng: Random) -> NDArray[Any]:
    """An array with another shape, type or a few other values."""
    kind = int(rng.integers(9))
    if kind == 0:
        return array.reshape(-1)
    if kind == 1:
        return array[None]
    if kind == 2:
        return array[: int(rng.integers(len(array) + 1))] if array.ndim else array
    if kind == 3:
        with np.errstate(all="ignore"):
            return array.astype(str(rng.choice(["<f8", "<i8", "<u1", "<f2", "<c16", "<U3", "?", ">f4", ">i2"])))
    if kind == 4:
        return array.reshape(-1)[0] if array.size else array[..., None]
    if kind == 5 and array.ndim > 1:
        return array[..., : int(rng.integers(array.shape[-1] + 1))]
    if kind == 6 and array.ndim > 1:
        return np.concatenate([array, array], -1)
    out = array.copy()
    if out.size == 0:
        return out
    flat = out.reshape(-1)
    for _ in range(int(rng.integers(1, 4))):
        at = int(rng.integers(flat.size))
        if out.dtype.kind == "f":
            with np.errstate(all="ignore"):
                flat[at] = rng.choice([np.nan, np.inf, -np.inf, 1e38, -1e38, 0, 1e-40, 1e300])
        elif out.dtype.kind in "iu":
            low, high = np.iinfo(out.dtype).min, np.iinfo(out.dtype).max
            flat[at] = (
                int([low, high, 0, max(low, -1), flat.size][rng.integers(5)]) & high
                if low == 0
                else int([low, high, 0, -1, min(flat.size, high)][rng.integers(5)])
            )
        elif out.dtype.kind == "O":
            flat[at] = ODD[rng.integers(len(ODD))]
        elif out.dtype.kind == "b":
            flat[at] = not flat[at]
    return out
