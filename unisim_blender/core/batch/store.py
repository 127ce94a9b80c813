"""Where a batch lies: a folder or an object store, by fsspec's URLs. Objects are there whole or not at all."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from ..errors import OutputError
from ..files import write_file
from ..remote.requests import file_system, tried

Result = TypeVar("Result")


@dataclass(frozen=True)
class Store:
    """A folder, or a prefix of an object store, by its URL. It pickles; each process connects by itself.

    Names of objects are relative, with slashes. Requests that fail are repeated, see `tried`; what then still fails is one
    sentence of an `OutputError`.
    """

    url: str

    @cached_property
    def _found(self) -> tuple[Any, str]:
        return file_system(self.url, OutputError)

    @property
    def folder(self) -> Path | None:
        """The folder on this machine; None for an object store."""
        fs, root = self._found
        return Path(root) if "file" in _protocols(fs) else None

    @property
    def in_one_process(self) -> bool:
        """Whether only the process that writes it sees it."""
        return "memory" in _protocols(self._found[0])

    def where(self, name: str) -> str:
        """Return an object's path or URL, to show."""
        return str(self.folder / name) if self.folder else f"{self.url.rstrip('/')}/{name}"

    def write(self, name: str, data: bytes) -> None:
        """Write an object: all of it, or nothing. Raises `OutputError`."""
        if self.folder is not None:
            write_file(self.folder / name, data)
            return
        self._tried(name, "written", lambda fs, path: fs.pipe_file(path, data))

    def read(self, name: str) -> bytes | None:
        """Return an object's bytes; None where it is not there. Raises `OutputError`."""

        def read(fs: Any, path: str) -> bytes | None:
            try:
                return bytes(fs.cat_file(path))
            except FileNotFoundError:
                return None

        return self._tried(name, "read", read)

    def sizes(self, prefix: str = "") -> dict[str, int]:
        """Return the sizes, in bytes, of all objects below a prefix, by their names. Raises `OutputError`."""
        root = str(self._found[1]).rstrip("/")

        def sizes(fs: Any, path: str) -> dict[str, int]:
            try:
                found = fs.find(path, detail=True)
            except FileNotFoundError:
                return {}
            return {name[len(root) :].lstrip("/"): int(info["size"]) for name, info in found.items()}

        return self._tried(prefix, "listed", sizes)

    def times(self, prefix: str = "") -> dict[str, float]:
        """Return when the objects below a prefix were written, in seconds since 1970 by the store's clock; of a store that keeps
        no times, nothing. Raises `OutputError`."""
        root = str(self._found[1]).rstrip("/")

        def times(fs: Any, path: str) -> dict[str, float]:
            try:
                found = fs.find(path, detail=True)
            except FileNotFoundError:
                return {}
            written = {name[len(root) :].lstrip("/"): _written_s(info) for name, info in found.items()}
            return {name: time_s for name, time_s in written.items() if time_s is not None}

        return self._tried(prefix, "listed", times)

    def remove(self, name: str) -> None:
        """Remove an object that may be there. Raises `OutputError`."""

        def remove(fs: Any, path: str) -> None:
            try:
                fs.rm_file(path)
            except FileNotFoundError:
                return

        self._tried(name, "removed", remove)

    def holds(self, name: str, digest: str, size: int, sizes: dict[str, int]) -> bool:
        """Return whether an object is as it was written. ``sizes`` are those of `sizes`; a folder's files are read, too, because
        a disk may lose what a store does not."""
        if sizes.get(name) != size:
            return False
        return self.folder is None or hashlib.sha256((self.folder / name).read_bytes()).hexdigest() == digest

    def _tried(self, name: str, done: str, request: Callable[[Any, str], Result]) -> Result:
        fs, root = self._found
        path = f"{str(root).rstrip('/')}/{name}" if name else str(root)
        return tried(lambda: request(fs, path), f"{self.where(name)}: cannot be {done}", OutputError)


def _protocols(fs: Any) -> tuple[str, ...]:
    return (fs.protocol,) if isinstance(fs.protocol, str) else tuple(fs.protocol)


def _written_s(info: dict[str, Any]) -> float | None:
    """Return when an object was written, by what its file system tells; each has a name of its own for that."""
    for member in ("mtime", "LastModified", "updated", "created"):
        value = info.get(member)
        if isinstance(value, str):
            value = datetime.fromisoformat(value.replace("Z", "+00:00"))
        if isinstance(value, datetime):
            return value.timestamp()
        if isinstance(value, int | float):
            return float(value)
    return None
