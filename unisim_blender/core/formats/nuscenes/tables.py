"""nuScenes' JSON tables: rows by their tokens, those alone that a scene needs.

A small table is read whole. A large one (that of all of v1.0-trainval's files has a gigabyte) is read in pieces, of which rows
that name none of the wanted tokens are passed over unread.
"""

from __future__ import annotations

import json
import re
from collections.abc import Collection, Iterator
from pathlib import Path
from typing import Any

from ...errors import LogError, in_a_line
from ...json_file import Node, check_finite, read_json

WHOLE_BYTES = 32 * 2**20
PIECE_BYTES = 8 * 2**20
_ROW = re.compile(r"\{[^{}]*\}")
"""Rows hold no objects."""


def rows(path: Path, key: str, wanted: Collection[str] | None = None) -> Iterator[Node]:
    """Give the rows of a table whose ``key`` is one of the ``wanted`` texts; all where that is None. Raises `LogError`."""
    for row in _all(path, key, wanted):
        if wanted is None or row.key(key).text() in wanted:
            yield row


def by_token(path: Path, wanted: Collection[str] | None = None) -> dict[str, Node]:
    """Return rows by their tokens. Raises `LogError` for wanted ones that are missing."""
    found = {row.key("token").text(): row for row in rows(path, "token", wanted)}
    absent = [token for token in wanted or () if token not in found]
    if absent:
        raise LogError(f"{path}: has no row {absent[0]!r}" + (f", nor {len(absent) - 1} others" if absent[1:] else ""))
    return found


def _all(path: Path, key: str, wanted: Collection[str] | None) -> Iterator[Node]:
    try:
        size = path.stat().st_size
    except FileNotFoundError as error:
        raise LogError(f"{path}: is missing") from error
    except OSError as error:
        raise LogError(f"{path}: cannot be read ({error.strerror})") from error
    if size <= WHOLE_BYTES or wanted is None:
        yield from Node(read_json(path, LogError), f"{path}: ", LogError).elements()
        return
    name = re.compile(rf'"{re.escape(key)}"\s*:\s*"([^"]*)"')
    for number, text in enumerate(_rows_as_text(path)):
        found = name.search(text)
        if found is None or found.group(1) not in wanted:
            continue
        try:
            row = json.loads(text)
        except ValueError as error:
            raise LogError(f"{path}: row {number} is not valid JSON: {in_a_line(error)}") from error
        check_finite(row, f"{path}: [{number}]", LogError)
        yield Node(row, f"{path}: [{number}]", LogError)


def _rows_as_text(path: Path) -> Iterator[str]:
    rest = ""
    try:
        with path.open(encoding="utf-8") as stream:
            while piece := stream.read(PIECE_BYTES):
                text = rest + piece
                end = 0
                for found in _ROW.finditer(text):
                    end = found.end()
                    yield found.group()
                rest = text[end:]
                if len(rest) > PIECE_BYTES:
                    raise LogError(f"{path}: is no table of rows")
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: is not UTF-8 text (byte {error.start})") from error
    if not rest.strip().endswith("]"):
        raise LogError(f"{path}: is cut off")


def quaternion(node: Node) -> Any:
    """Return a rotation (4,), w x y z, of length 1. Raises `LogError`."""
    values = node.array(4)
    length = float((values @ values) ** 0.5)
    if abs(length - 1) > 1e-3:
        node.fail(f"has length {length:.6g}, not 1")
    return values / length
