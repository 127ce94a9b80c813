"""Formats that are made of all captures of a variant: the variant's folder is put together, and they are written from it."""

from __future__ import annotations

import hashlib
from pathlib import Path

from ..errors import OutputError
from ..export.formats import write_sequence
from ..files import write_file
from ..formats.rendered import MANIFEST
from ..json_file import json_bytes
from ..sequence.manifest import make_manifest, write_drive
from ..sequence.records import CaptureRecord, write_record
from .records import CAPTURES, CaptureEntry
from .store import Store
from .units import FormatsUnit


def write_formats(unit: FormatsUnit, store: Store, out: Path) -> list[Path]:
    """Write a variant's formats into a new folder ``out``, which then holds what `unisim render` leaves of it, too. Return the
    files of the formats alone. Raises `UnisimError`.

    Files that name images name those of the store, as seen from the variant's place in it.
    """
    images = _lay_out(unit, store, out)
    before = {path for path in out.rglob("*") if path.is_file()}
    for name in unit.formats:
        write_sequence(name, unit.plan, out, images)
    return sorted({path for path in out.rglob("*") if path.is_file()} - before)


def _lay_out(unit: FormatsUnit, store: Store, out: Path) -> dict[str, str]:
    """Put a variant's captures together; what they are called in the store, by their paths in ``out``."""
    called: dict[str, str] = {}
    for moment in unit.plan.moments:
        captures = {}
        for name, identity in unit.moments[moment.name].items():
            files = _copied(identity, unit.entries[identity], store, out)
            called |= {inside: f"../../{CAPTURES}/{identity[:2]}/{identity}/{inside}" for inside in files}
            entry = unit.entries[identity]
            captures[name] = CaptureRecord(identity, files, entry.sees, entry.samples)
        write_record(out, moment.key, captures, finished=True)
    write_drive(unit.plan, out)
    write_file(out / MANIFEST, json_bytes(make_manifest(unit.plan, out, {})))
    return called


def _copied(identity: str, entry: CaptureEntry, store: Store, out: Path) -> dict[str, str]:
    """Copy a capture's files; their digests by their paths in ``out``. Raises `OutputError` where one is not what was stored."""
    digests = {}
    for name, one in entry.files.items():
        data = store.read(name)
        if data is None or hashlib.sha256(data).hexdigest() != one.sha256:
            raise OutputError(f"{store.where(name)}: is not what was stored there; render it again with --resume")
        inside = name.removeprefix(f"{CAPTURES}/{identity[:2]}/{identity}/")
        write_file(out / inside, data)
        digests[inside] = one.sha256
    return digests
