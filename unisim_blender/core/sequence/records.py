"""Records of a sequence's finished captures: what each was rendered from, and the digests of its files.

Once all captures of a moment are finished, its record is `.state/000042.json`
(at a time: `.state/t0000001050000us.json`). While some are missing or out of date, the others are in
`.state/000042.kept`. A record is written after the files that it names.
"""

from __future__ import annotations

import json
from collections.abc import Container, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from ..errors import OutputError, refused
from ..files import sha256_of_file, write_file
from ..json_file import json_bytes
from ..world.captures import CaptureKey, in_order, key_of, name_of

STATE_FOLDER = ".state"


@dataclass(frozen=True)
class CaptureRecord:
    """``identity`` is the digest of all that the capture depends on; ``sees`` are the ids of the actors that it can
    see; ``files`` are digests by path below the output folder; ``samples`` are counts, ``max_error`` the report of
    its error bounds."""

    identity: str
    files: Mapping[str, str]
    sees: tuple[str, ...] = ()
    samples: Mapping[str, int] = field(default_factory=dict)
    max_error: Mapping[str, Any] | None = None

    def is_whole(self, out: Path) -> bool:
        """Return whether all files exist and have the digests with which they were written."""
        return all(
            (out / name).is_file() and sha256_of_file(out / name) == digest for name, digest in self.files.items()
        )


Captures = dict[str, CaptureRecord]
"""By name: "camera/front_camera", "lidar/pandar64", "labels"."""


def finished_moments(out: Path, wanted: Container[CaptureKey] | None = None) -> int:
    """Count the finished moments of the sequence in folder ``out``: of all, or only of those ``wanted``."""
    return sum(1 for path in (out / STATE_FOLDER).glob("*.json") if wanted is None or _key(path) in wanted)


def read_records(out: Path) -> dict[CaptureKey, Captures]:
    """Return the captures of all moments, in order. A record that cannot be read is removed, and its captures
    count as missing."""
    records: dict[CaptureKey, Captures] = {}
    for path in sorted([*(out / STATE_FOLDER).glob("*.json"), *(out / STATE_FOLDER).glob("*.kept")]):
        try:
            captures = json.loads(path.read_bytes())["captures"]
            records[key_of(path.stem)] = {name: _record(values) for name, values in captures.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            path.unlink(missing_ok=True)
    return {key: records[key] for key in in_order(records)}


def write_record(out: Path, key: CaptureKey, captures: Captures, finished: bool) -> None:
    """Write or replace the record of a moment; remove it if there are no captures. Raises `OutputError`."""
    record, unfinished = (out / STATE_FOLDER / f"{name_of(key)}{suffix}" for suffix in (".json", ".kept"))
    stale, path = (unfinished, record) if finished else (record, unfinished)
    if captures:
        document = {"frame": key, "captures": {name: asdict(captures[name]) for name in sorted(captures)}}
        write_file(path, json_bytes(document))
    else:
        path.unlink(missing_ok=True)
    stale.unlink(missing_ok=True)


def remove_files(out: Path, record: CaptureRecord) -> None:
    """Remove the files of a capture. Raises `OutputError`."""
    for name in record.files:
        with refused(out / name, "removed", OutputError):
            (out / name).unlink(missing_ok=True)


def _key(path: Path) -> CaptureKey | None:
    try:
        return key_of(path.stem)
    except ValueError:
        return None


def _record(values: dict[str, Any]) -> CaptureRecord:
    """Return a capture's record. Raises ValueError, KeyError or TypeError for values that a sequence never writes."""
    files = dict(values["files"])
    sees = tuple(values["sees"])
    samples = dict(values["samples"])
    error = values["max_error"]
    if not all(_is_inside(name) and isinstance(digest, str) for name, digest in files.items()):
        raise ValueError("names a file elsewhere")
    if not all(isinstance(uid, str) for uid in sees) or {type(count) for count in samples.values()} - {int}:
        raise ValueError("counts no samples")
    if error is not None and (type(error["kept"]) is not bool or not isinstance(error["settings"], str)):
        raise ValueError("says nothing of its error")
    return CaptureRecord(str(values["identity"]), files, sees, samples, error)


def _is_inside(name: str) -> bool:
    """Return whether a record's file lies in the folder of frames; no other file may be removed."""
    path = PurePosixPath(name)
    return (
        bool(path.parts)
        and not path.is_absolute()
        and ".." not in path.parts
        and name.isprintable()
        and not {"\\", ":"} & set(name)
    )
