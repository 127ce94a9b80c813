"""Which files below a folder are opened, as Python's audit events tell. Arrow's files are opened by C++, and are not told of."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_recorded: list[tuple[str, set[str]]] = []


def _note(event: str, arguments: tuple[object, ...]) -> None:
    if event == "open" and _recorded and isinstance(arguments[0], str | bytes | os.PathLike):
        path = os.path.abspath(os.fsdecode(arguments[0]))
        for folder, opened in _recorded:
            if path.startswith(folder) and os.path.isfile(path):
                opened.add(path.removeprefix(folder))


sys.addaudithook(_note)  # for good: it cannot be taken back, and notes nothing unless something is recorded


@contextmanager
def opened_below(folder: Path) -> Iterator[set[str]]:
    """Give a set that files which are opened below a folder come into, by their names from there."""
    recorded = os.path.join(os.path.abspath(folder), ""), set[str]()
    _recorded.append(recorded)
    try:
        yield recorded[1]
    finally:
        _recorded.remove(recorded)
