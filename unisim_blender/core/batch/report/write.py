"""The report of a batch, read off its store alone."""

from __future__ import annotations

import json
from typing import Any

from ...errors import OutputError
from ..manifest import MANIFEST_NAME
from ..records import read_failures
from ..store import Store
from .page import report_page
from .rows import rows_of
from .thumbnails import thumbnails

REPORT_NAME = "report.html"


def batch_report(store: Store, beside: bool = True) -> bytes:
    """Return the report of a batch as HTML: a function of what the store holds.

    ``beside`` says whether it will lie in the store; else it names objects by their whole paths or URLs. Raises `OutputError`
    where the store has no manifest, which every run of a batch writes at its end.
    """
    data = store.read(MANIFEST_NAME)
    if data is None:
        raise OutputError(
            f"{store.where(MANIFEST_NAME)}: is not written yet: the batch runs, or continues with --resume"
        )
    try:
        manifest = json.loads(data)
        failures = read_failures(store)
        rows = rows_of(manifest, failures)
        title = _title(manifest)
        images = thumbnails(store, [row.images for row in rows])
        place = "" if beside and store.folder is not None else store.where("")
        place = place if not place or place.endswith("/") else f"{place}/"
        return report_page(title, manifest["counts"], rows, failures, images, place).encode()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise OutputError(f"{store.where(MANIFEST_NAME)}: is none of a batch") from error


def write_report(store: Store) -> None:
    """Write the report into the store. Raises `OutputError`."""
    store.write(REPORT_NAME, batch_report(store))


def _title(manifest: dict[str, Any]) -> str:
    """Return the names of the scenarios, or how many there are."""
    names = list(dict.fromkeys(variant["scenario"]["name"] for variant in manifest["variants"].values()))
    return ", ".join(names) if len(names) <= 3 else f"{len(names)} scenarios"
