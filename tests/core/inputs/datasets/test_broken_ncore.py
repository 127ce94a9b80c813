"""NCore's sequences with faults: stores that are folders, and .itar files; by NCore's own API, and by our writer."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from hypothesis import given

from inputs.datasets.logs import layout
from inputs.strategies import Input

pytest.importorskip("ncore.data.v4", reason="nvidia-ncore is not installed: pip install '.[ncore]'")

from ncore_by_hand import write_by_hand  # noqa: E402
from ncore_drive import MadeLog  # noqa: E402

from unisim_blender.core.formats.ncore.write import write_ncore  # noqa: E402

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def itar(folder: Path) -> Path:
    (folder / "log").mkdir()
    return write_by_hand(folder / "log")


def directory(folder: Path) -> Path:
    (folder / "log").mkdir()
    return write_by_hand(folder / "log", store="directory")


def ours(folder: Path) -> Path:
    write_ncore(folder / "log", MadeLog())
    return folder / "log"


def views(name: str) -> list[str]:
    path = Path(name)
    if path.name in (".zattrs", ".zgroup", ".zarray") or path.suffix == ".json":
        return ["json"]
    if path.suffix == ".itar":
        return ["index", "parts", "parts", "parts"]
    return ["unpacked"] if path.parent.name in UNPACKED else []


UNPACKED = ("direction", "timestamp_us", "model_element", "distance_m", "intensity")


def early(name: str) -> bool:
    """Whether a file is of no frame, or of one of the first."""
    parts = Path(name).parts
    stamps = [after for before, after in zip(parts, parts[1:], strict=False) if before == "frames" and after.isdigit()]
    return not stamps or int(stamps[0]) < LATE_US


LATE_US = 1_700_000_000_150_000
FOLDERS, FILES, OURS = layout(directory, views, early), layout(itar, views), layout(ours, views)


@given(FOLDERS.inputs)
def test_stores_that_are_folders(changes: Input) -> None:
    FOLDERS.check(changes)


@given(FILES.inputs)
def test_stores_that_are_files(changes: Input) -> None:
    FILES.check(changes)


@given(OURS.inputs)
def test_sequences_of_our_own(changes: Input) -> None:
    OURS.check(changes)
