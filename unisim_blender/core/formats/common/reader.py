"""Interface of a reader of recorded drives: it recognises the folders or files of one dataset, and opens them."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from ...data.log import Log
from ...errors import short
from ...registry import Registry


class Reader(Protocol):
    """A dataset's layout. An instance, or a class whose methods are static; what reads the log is imported by `open`
    alone."""

    name: str
    """One word, unique among readers: "pandaset"."""
    layout: str
    """How a person recognises the layout, for messages: "PandaSet: a folder with lidar/ and camera/"."""
    suffixes: tuple[str, ...]
    """Of the log's files that can be dropped onto Blender's window: (".json",)."""

    def recognises(self, path: Path) -> bool:
        """Whether the folder or file is a log in this layout. Only names are looked at, so that it costs nothing."""
        ...

    def open(self, path: Path) -> Log:
        """Open a log that `recognises` is true of. Raises `LogError` naming file and value."""
        ...


def _check_suffixes(reader: Reader) -> None:
    """Raise `TypeError` for suffixes that Blender could not be given: it would refuse the whole extension."""
    suffixes: object = reader.suffixes
    texts = isinstance(suffixes, list | tuple) and all(isinstance(suffix, str) for suffix in suffixes)
    if not texts or not all(suffix.startswith(".") and ";" not in suffix for suffix in reader.suffixes):
        raise TypeError(f"its suffixes are {short(suffixes)}, not texts such as ('.json',)")


READERS: Registry[Reader] = Registry(
    "a reader", "unisim_blender.logs", ("name", "layout", "suffixes", "recognises", "open"), _check_suffixes
)
"""The registered readers by their names: `readers.py` registers the package's own."""
register = READERS.register
