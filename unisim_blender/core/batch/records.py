"""The store of a batch, a folder or an object store by fsspec's URLs, and the records of finished units in it.

Objects are there whole or not at all. A record is written after all objects that it names: it is the commit.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from ..errors import OutputError
from ..files import write_file
from ..json_file import json_bytes
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
    def _file_system(self) -> tuple[Any, str]:
        return file_system(self.url, OutputError)

    @property
    def folder(self) -> Path | None:
        """The folder on this machine; None for an object store."""
        fs, root = self._file_system
        return Path(root) if "file" in _protocols(fs) else None

    @property
    def seen_by_its_process_only(self) -> bool:
        """Whether only the process that writes it sees it."""
        return "memory" in _protocols(self._file_system[0])

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
        return {name: int(info["size"]) for name, info in self._listed(prefix).items()}

    def times(self, prefix: str = "") -> dict[str, float]:
        """Return when the objects below a prefix were written, in seconds since 1970 by the store's clock; of a store that keeps
        no times, nothing. Raises `OutputError`."""
        written = {name: _written_s(info) for name, info in self._listed(prefix).items()}
        return {name: time_s for name, time_s in written.items() if time_s is not None}

    def remove(self, name: str) -> None:
        """Remove an object that may be there. Raises `OutputError`."""

        def remove(fs: Any, path: str) -> None:
            with suppress(FileNotFoundError):
                fs.rm_file(path)

        self._tried(name, "removed", remove)

    def holds(self, name: str, digest: str, size: int, sizes: dict[str, int]) -> bool:
        """Return whether an object is as it was written. ``sizes`` are those of `sizes`; a folder's files are read, too, because
        a disk may lose what a store does not."""
        if sizes.get(name) != size:
            return False
        return self.folder is None or hashlib.sha256((self.folder / name).read_bytes()).hexdigest() == digest

    def _listed(self, prefix: str) -> dict[str, dict[str, Any]]:
        """Return what the file system tells of all objects below a prefix, by their names."""
        root = str(self._file_system[1]).rstrip("/")

        def listed(fs: Any, path: str) -> dict[str, dict[str, Any]]:
            with suppress(FileNotFoundError):
                return {name[len(root) :].lstrip("/"): info for name, info in fs.find(path, detail=True).items()}
            return {}

        return self._tried(prefix, "listed", listed)

    def _tried(self, name: str, done: str, request: Callable[[Any, str], Result]) -> Result:
        fs, root = self._file_system
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


RECORDS = "records"
FORMATS = "formats"
CAPTURES, ROLLOUTS, VARIANTS = "captures", "rollouts", "variants"
FAILURES = "failures"


@dataclass(frozen=True)
class StoredFile:
    """The digest and the size in bytes of an object."""

    sha256: str
    bytes: int


Files = dict[str, StoredFile]
"""By the objects' names."""


@dataclass(frozen=True)
class CaptureEntry:
    """A capture, or a moment's labels: its ``files``, the actors that it can see, and counts of samples."""

    files: Files
    sees: tuple[str, ...] = ()
    samples: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class UnitRecord:
    """Outputs of a unit: ``captures`` by identity, or the files and scores of a rollout."""

    unit: str
    captures: Mapping[str, CaptureEntry] = field(default_factory=dict)
    files: Files = field(default_factory=dict)
    scores: Mapping[str, Any] | None = None

    def every_file(self) -> Files:
        """Return all objects that the record names."""
        return {**self.files, **{name: file for entry in self.captures.values() for name, file in entry.files.items()}}


def scenario_name(variant: str) -> str:
    """Return the name of the object that holds a variant's scenario."""
    return f"{VARIANTS}/{variant}/scenario.json"


def record_name(unit: str, place: str = RECORDS) -> str:
    """Return the name of a unit's record: in `RECORDS`, or in `FORMATS` of one that writes a whole variant's."""
    return f"{place}/{unit}.json"


def write_unit_record(store: Store, record: UnitRecord, place: str = RECORDS) -> None:
    """Write a unit's record; all objects that it names must be there. Raises `OutputError`."""
    store.write(record_name(record.unit, place), json_bytes(asdict(record)))


def read_unit_record(store: Store, unit: str, place: str = RECORDS) -> UnitRecord | None:
    """Return a unit's record; None where there is none that can be read. Raises `OutputError`."""
    data = store.read(record_name(unit, place))
    try:
        return None if data is None else _record(json.loads(data))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def read_failures(store: Store) -> list[dict[str, Any]]:
    """Return what is noted of units that failed, in their order. Raises `OutputError`."""
    failures = [json.loads(store.read(name) or b"{}") for name in sorted(store.sizes(FAILURES))]
    return [failure for failure in failures if isinstance(failure, dict)]


def _record(values: Any) -> UnitRecord:
    captures = {
        identity: CaptureEntry(_files(entry["files"]), tuple(entry["sees"]), dict(entry["samples"]))
        for identity, entry in values["captures"].items()
    }
    return UnitRecord(values["unit"], captures, _files(values["files"]), values["scores"])


def _files(values: Mapping[str, Any]) -> Files:
    return {name: StoredFile(str(file["sha256"]), int(file["bytes"])) for name, file in values.items()}
