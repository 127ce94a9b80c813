"""What can be wrong with a file: faults of JSON values, of bytes and of arrays, each a value that says what it changes.

A fault whose place is not there (another fault took it away) changes nothing.
"""

from __future__ import annotations

import copy
import json
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Path = tuple[Any, ...]
"""Keys and numbers from a document's root to a member."""
MOST_MEMBERS = 200_000
"""No document grows beyond this: files of any size take a time of their own to be parsed."""


class Fault(Protocol):
    """A fault gives what it makes of a value; it may change the value in place."""

    def applied(self, value: Any) -> Any:
        """Return the value with the fault."""
        ...


def paths_of(value: Any, path: Path = ()) -> list[Path]:
    """Return the paths of all members of a JSON value."""
    found: list[Path] = []
    for key, member in (
        value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    ):
        found += [(*path, key), *paths_of(member, (*path, key))]
    return found


def parent_of(value: Any, path: Path) -> Any:
    """Return the object or list that a path's last step is taken in; None where the path leads nowhere."""
    try:
        for key in path[:-1]:
            value = value[key]
    except (LookupError, TypeError):
        return None
    return value if isinstance(value, dict | list) else None


def holder_of(value: Any, path: Path) -> Any:
    """Return what holds a path's member; None where it is not there."""
    holder = parent_of(value, path)
    try:
        holder[path[-1]]
    except (LookupError, TypeError):
        return None
    return holder


def member_of(value: Any, path: Path) -> Any:
    """Return a path's member, which must be there."""
    for key in path:
        value = value[key]
    return value


@dataclass(frozen=True)
class Put:
    """Another value in a member's place, or a new member of an object; () is the whole document."""

    path: Path
    value: Any

    def applied(self, value: Any) -> Any:
        if not self.path:
            return copy.deepcopy(self.value)
        holder = parent_of(value, self.path)
        if isinstance(holder, dict) or holder_of(value, self.path) is not None:
            holder[self.path[-1]] = copy.deepcopy(self.value)
        return value


@dataclass(frozen=True)
class Drop:
    """A member is not there."""

    path: Path

    def applied(self, value: Any) -> Any:
        if (holder := holder_of(value, self.path)) is not None:
            del holder[self.path[-1]]
        return value


@dataclass(frozen=True)
class End:
    """A list ends before one of its members."""

    path: Path

    def applied(self, value: Any) -> Any:
        if isinstance(holder := holder_of(value, self.path), list):
            del holder[self.path[-1] :]
        return value


@dataclass(frozen=True)
class Repeat:
    """A member of a list stands there so many times more."""

    path: Path
    times: int

    def applied(self, value: Any) -> Any:
        holder = holder_of(value, self.path)
        if isinstance(holder, list):
            at = self.path[-1]
            size = 1 + len(paths_of(holder[at])) + len(json.dumps(holder[at])) // 20
            count = max(0, min(self.times, (MOST_MEMBERS - len(paths_of(value))) // size))
            # copies, for one that is shared would grow everywhere at once
            holder[at:at] = [copy.deepcopy(holder[at]) for _ in range(count)]
        return value


@dataclass(frozen=True)
class Scale:
    """A number is so many times larger."""

    path: Path
    factor: float

    def applied(self, value: Any) -> Any:
        holder = holder_of(value, self.path)
        if holder is not None and isinstance(old := holder[self.path[-1]], int | float) and not isinstance(old, bool):
            try:
                holder[self.path[-1]] = type(old)(old * self.factor)
            except (OverflowError, ValueError):
                pass
        return value


@dataclass(frozen=True)
class Copy:
    """A member is what another one is."""

    path: Path
    source: Path

    def applied(self, value: Any) -> Any:
        holder, other = holder_of(value, self.path), holder_of(value, self.source)
        if holder is not None and other is not None and len(paths_of(value)) < MOST_MEMBERS // 20:
            holder[self.path[-1]] = copy.deepcopy(other[self.source[-1]])
        return value


@dataclass(frozen=True)
class Rename:
    """A member of an object has another name; ``keeps`` leaves it under its own, too."""

    path: Path
    name: str
    keeps: bool = False

    def applied(self, value: Any) -> Any:
        if isinstance(holder := holder_of(value, self.path), dict):
            holder[self.name] = holder[self.path[-1]] if self.keeps else holder.pop(self.path[-1])
        return value


@dataclass(frozen=True)
class Bytes:
    """``length`` bytes from ``at`` on are ``data``; ``at`` counts round."""

    at: int
    length: int
    data: bytes

    def applied(self, value: bytes) -> bytes:
        at = self.at % (len(value) + 1)
        return value[:at] + self.data + value[at + self.length :]


@dataclass(frozen=True)
class Twice:
    """``length`` bytes from ``at`` on stand there twice."""

    at: int
    length: int

    def applied(self, value: bytes) -> bytes:
        at = self.at % (len(value) + 1)
        return value[: at + self.length] + value[at:]


@dataclass(frozen=True)
class CutOff:
    """The file ends at ``at``, which counts round."""

    at: int

    def applied(self, value: bytes) -> bytes:
        return value[: self.at % (len(value) + 1)]


@dataclass(frozen=True)
class Array:
    """One array of several is of another shape, type or value."""

    name: str
    change: ArrayFault

    def applied(self, value: Any) -> Any:
        if isinstance(value, dict) and isinstance(found := value.get(self.name), np.ndarray):
            value[self.name] = self.change.changed(found)
        return value


class ArrayFault(Protocol):
    """What is wrong with an array."""

    def changed(self, array: NDArray[Any]) -> NDArray[Any]:
        """Return the array with the fault."""
        ...


@dataclass(frozen=True)
class Shape:
    """Another shape: "flat", "one more axis", "a scalar", "twice as wide", "rows" or "columns" (so many are left)."""

    kind: str
    count: int = 0

    def changed(self, array: NDArray[Any]) -> NDArray[Any]:
        if self.kind == "flat":
            return array.reshape(-1)
        if self.kind == "a scalar":
            return np.asarray(array.reshape(-1)[0]) if array.size else array[..., None]
        if self.kind == "rows" and array.ndim:
            return array[: self.count % (len(array) + 1)]
        if self.kind == "columns" and array.ndim > 1:
            return array[..., : self.count % (array.shape[-1] + 1)]
        if self.kind == "twice as wide" and array.ndim > 1:
            return np.concatenate([array, array], -1)
        return array[None]


SHAPES = ("flat", "one more axis", "a scalar", "twice as wide", "rows", "columns")


@dataclass(frozen=True)
class Type:
    """Another dtype."""

    dtype: str

    def changed(self, array: NDArray[Any]) -> NDArray[Any]:
        try:
            with np.errstate(all="ignore"):
                return array.astype(self.dtype)
        except (ValueError, TypeError):
            return array


TYPES = ("<f8", "<i8", "<u1", "<f2", "<f4", "<c16", "<U3", "?", ">f4", ">i2", "O")


@dataclass(frozen=True)
class Entry:
    """One entry is another; ``at`` counts round. What the array's dtype cannot hold comes as near as it can."""

    at: int
    value: Any

    def changed(self, array: NDArray[Any]) -> NDArray[Any]:
        out = array.copy()
        if out.size == 0:
            return out
        value = self.value
        if out.dtype.kind in "iu":
            limits = np.iinfo(out.dtype)
            number = value if isinstance(value, int | float) and np.isfinite(value) else limits.max
            value = max(int(limits.min), min(int(limits.max), int(number)))
        try:
            with np.errstate(all="ignore"):
                out.reshape(-1)[self.at % out.size] = value
        except (ValueError, TypeError, OverflowError):
            pass
        return out
