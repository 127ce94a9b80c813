"""Records of finished units. A record is written after all objects that it names: it is the commit."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

from ..json_file import json_bytes
from .store import Store

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
        return {**self.files, **{name: one for entry in self.captures.values() for name, one in entry.files.items()}}


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
    found = [json.loads(store.read(name) or b"{}") for name in sorted(store.sizes(FAILURES))]
    return [one for one in found if isinstance(one, dict)]


def _record(values: Any) -> UnitRecord:
    captures = {
        identity: CaptureEntry(_files(one["files"]), tuple(one["sees"]), dict(one["samples"]))
        for identity, one in values["captures"].items()
    }
    return UnitRecord(values["unit"], captures, _files(values["files"]), values["scores"])


def _files(values: Mapping[str, Any]) -> Files:
    return {name: StoredFile(str(one["sha256"]), int(one["bytes"])) for name, one in values.items()}
