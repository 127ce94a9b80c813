"""JSON documents on disk: finite numbers only, written whole or not at all, and read with every fault's place."""

from __future__ import annotations

import io
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from .errors import UnisimError, refused, short
from .geometry import FloatArray

ROTATION_TOLERANCE = 1e-3
"""How far from 1 and 0 the products of a rotation's axes may be."""
MAX_INTEGER = 2**53
"""Whole numbers up to here are exact in float64."""
_BETWEEN = re.compile(r"[ \t\n\r]*([,\]]?)[ \t\n\r]*")
_END = re.compile(r"[ \t\n\r]*}[ \t\n\r]*")


def read_json(path: Path, error: type[UnisimError]) -> Any:
    """The document at ``path``. Raises ``error`` where it cannot be read, is no JSON or holds a number
    that is not finite."""
    return parse_json(read_bytes(path, error), path, error)


def read_bytes(path: Path, error: type[UnisimError]) -> bytes:
    """Return a file's content. Raises ``error`` where it cannot be read."""
    with refused(path, "read", error):
        return Path(path).read_bytes()


def parse_json(content: bytes, path: Path, error: type[UnisimError]) -> Any:
    """Return the document that the file ``path`` holds as ``content``; see `read_json`."""

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        result = dict(pairs)
        if len(result) < len(pairs):
            keys = [key for key, _ in pairs]
            twice = next(key for key in keys if keys.count(key) > 1)
            raise error(f'{path}: the key "{twice}" stands twice in one object')
        return result

    with refused(path, "read", error):
        text = io.StringIO(content.decode("utf-8"), newline=None).read()
    try:
        document = json.loads(text, object_pairs_hook=unique)
    except RecursionError as fault:
        raise error(f"{path}: is nested too deeply") from fault
    except ValueError as fault:
        raise error(f"{path}: is not valid JSON: {fault}") from fault
    check_finite(document, f"{path}: ", error)
    return document


def members_of(text: str, key: str) -> Iterator[Any]:
    """Yield the members of the list that an object has under a key, decoded one by one: all at once take far more memory than
    their text.

    Raises `KeyError` or `TypeError` where it has none, and `ValueError` where the text is no JSON, which may be after members.
    """
    begin = re.match(rf"[ \t\n\r]*{{[ \t\n\r]*{re.escape(json.dumps(key))}[ \t\n\r]*:[ \t\n\r]*\[[ \t\n\r]*", text)
    if begin is None:
        whole = json.loads(text)[key]
        if not isinstance(whole, list):
            raise TypeError(f"{key} is no list")
        yield from whole
        return
    decoder, at = json.JSONDecoder(), begin.end()
    if text[at] == "]":
        at += 1
    else:
        while True:
            member, at = decoder.raw_decode(text, at)
            yield member
            between = _BETWEEN.match(text, at)
            assert between is not None
            at = between.end()
            if between[1] == "]":
                break
            if between[1] != ",":
                raise json.JSONDecodeError("Expecting ',' delimiter", text, at)
    if _END.fullmatch(text, at) is None:
        json.loads(text)  # more may follow, if it is JSON


def check_finite(value: Any, place: str, error: type[UnisimError]) -> None:
    """Raise ``error`` for the first number in a JSON value that float64 cannot hold, and for the first text that UTF-8
    cannot or that holds a NUL, which no path may; ``place`` is the value's own."""
    if isinstance(value, dict):
        for key, member in value.items():
            check_finite(key, place, error)
            check_finite(member, f"{place}{key}" if place.endswith(": ") else f"{place}.{key}", error)
    elif isinstance(value, list):
        for index, member in enumerate(value):
            check_finite(member, f"{place}[{index}]", error)
    elif isinstance(value, float) and not math.isfinite(value):
        raise error(f"{place}: {value} is not a finite number")
    elif isinstance(value, str) and (
        "\0" in value or (not value.isascii() and any("\ud800" <= letter <= "\udfff" for letter in value))
    ):
        raise error(f"{place.removesuffix(': ')}: holds a text that is none: {short(value)}")
    elif isinstance(value, int) and abs(value) > MAX_INTEGER:
        raise error(f"{place}: is a whole number beyond 2^53")


class Node:
    """A value of a JSON document that knows its place, so that every complaint names it.

    The place of a document's root may be a file: `Node(value, f"{path}: ", SceneError)`.
    """

    def __init__(self, value: Any, place: str, error: type[UnisimError]) -> None:
        self.value = value
        self.place = place
        self.error = error

    def fail(self, problem: str) -> NoReturn:
        """Raise the document's error for this place."""
        raise self.error(f"{self.place.removesuffix(': ')}: {problem}")

    def _at(self, step: str, value: Any) -> Node:
        return Node(value, self.place + (step.removeprefix(".") if self.place.endswith(": ") else step), self.error)

    def key(self, name: str) -> Node:
        """The member ``name`` of an object."""
        if name not in self.object():
            self.fail(f'"{name}" is missing')
        return self._at(f".{name}", self.value[name])

    def object(self) -> dict[str, Any]:
        """The value as a dictionary."""
        if not isinstance(self.value, dict):
            self.fail(f"must be an object, not {_short(self.value)}")
        return dict(self.value)

    def members(self) -> Iterator[tuple[str, Node]]:
        """Name and node of every member of an object."""
        for name, value in self.object().items():
            yield name, self._at(f".{name}", value)

    def elements(self) -> Iterator[Node]:
        """Nodes of an array's elements."""
        if not isinstance(self.value, list):
            self.fail(f"must be an array, not {_short(self.value)}")
        for index, value in enumerate(self.value):
            yield self._at(f"[{index}]", value)

    def text(self) -> str:
        """The value as a string."""
        if not isinstance(self.value, str):
            self.fail(f"must be a string, not {_short(self.value)}")
        return str(self.value)

    def flag(self) -> bool:
        if not isinstance(self.value, bool):
            self.fail(f"must be true or false, not {_short(self.value)}")
        return bool(self.value)

    def number(self) -> float:
        """The value as a finite number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float) or not math.isfinite(self.value):
            self.fail(f"must be a finite number, not {_short(self.value)}")
        return float(self.value)

    def integer(self, at_least: int | None = None) -> int:
        """The value as a whole number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            self.fail(f"must be a whole number, not {_short(self.value)}")
        if at_least is not None and self.value < at_least:
            self.fail(f"must be at least {at_least}, not {self.value}")
        return int(self.value)

    def array(self, *shape: int) -> FloatArray:
        """The value as finite numbers of ``shape``; -1 stands for any length."""
        wanted = " x ".join("N" if n < 0 else str(n) for n in shape)
        try:
            # numpy makes room for the longest text of a list as often as it has members
            array = np.array(self.value if _of_numbers(self.value) else None)
        except ValueError:
            array = np.array(None)
        if array.size == 0 and shape[0] == -1 and array.ndim == 1:
            array = np.zeros((0, *shape[1:]))
        fits = array.ndim == len(shape) and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
        if not fits or array.dtype.kind not in "fi":
            self.fail(f"must be {wanted} numbers, not {_short(self.value)}")
        if not np.isfinite(array).all():
            self.fail(f"holds a number that is not finite: {array[~np.isfinite(array)][0]}")
        return np.asarray(array, np.float64)

    def pose(self) -> FloatArray:
        """The value as a rigid pose (4, 4): a rotation and a place."""
        pose = self.array(4, 4)
        if not _is_pose(pose):
            self.fail(f"is no pose, a rotation and a place: {_short(self.value)}")
        return pose


def _is_pose(pose: FloatArray) -> bool:
    rotation = pose[:3, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        square = np.abs(rotation @ rotation.T - np.eye(3)).max()
        return bool(square <= ROTATION_TOLERANCE and np.linalg.det(rotation) > 0 and (pose[3] == [0, 0, 0, 1]).all())


def _of_numbers(value: Any) -> bool:
    """Whether a JSON value is a number, or lists of these at any depth."""
    if isinstance(value, list):
        return all(map(_of_numbers, value))
    return isinstance(value, int | float) and not isinstance(value, bool)


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


def json_bytes(document: Any) -> bytes:
    """A JSON document in one fixed form: indented, keys in their order, finite numbers only."""
    return (json.dumps(document, indent=1, allow_nan=False) + "\n").encode()
