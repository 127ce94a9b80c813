"""Recorded drives with faults: JSON files, tables, images, in our own layout and in PandaSet's."""

from __future__ import annotations

import io
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import example, given
from PIL import Image
from small_log import write_small_log

from inputs.datasets.logs import read_log
from inputs.faults import Bytes, Drop, Put
from inputs.promise import Property, Reader
from inputs.strategies import Input, gone, inputs_of
from inputs.views import In
from unisim_blender.core.formats.readers import open_log

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")
VIEWS = {".json": ["json"], ".gz": ["table", "unzipped"], ".jpg": []}


def log_reader(own: bool, *suffixes: str) -> Callable[[Path], Reader]:
    """A log of which files of some suffixes have faults or are missing; one that is not ``own`` lacks what
    PandaSet has not."""

    def make(folder: Path) -> Reader:
        log = folder / "log"
        write_small_log(log)
        if not own:
            (log / "meta" / "unisim.json").unlink()
        files = sorted(path for path in log.rglob("*") if path.suffix in suffixes)
        whole = {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}
        inputs = inputs_of(whole, {name: VIEWS[Path(name).suffix] for name in whole})
        # one in a few is missing
        return Reader(folder, whole, lambda: read_log(log), inputs | inputs | inputs | gone(whole), ("log",))

    return make


def image_reader(folder: Path) -> Reader:
    """Recorded images, baseline and progressive; the one with faults is in the first one's place."""
    write_small_log(folder / "log")
    log = open_log(folder / "log")
    file = log.image_path("front_camera", 1)
    assert file is not None
    progressive = io.BytesIO()
    Image.open(file).save(progressive, "JPEG", progressive=True)
    others = [path for path in (log.image_path("front_camera", frame) for frame in (1, 2)) if path is not None]
    names = [path.relative_to(folder).as_posix() for path in others]
    whole = dict(zip(names, (file.read_bytes(), progressive.getvalue()), strict=True))
    inputs = inputs_of(whole, {})
    return Reader(folder, whole, lambda: [log.image("front_camera", frame) for frame in (1, 2)], inputs, tuple(names))


TEXTS, TABLES = Property(log_reader(True, ".json")), Property(log_reader(True, ".gz", ".jpg"))
PANDASET, IMAGES = Property(log_reader(False, ".json", ".gz")), Property(image_reader)


@given(TEXTS.inputs)
@example([In("log/meta/unisim.json", "json", (Drop(("frames", 0)),))])
@example([In("log/lidar/poses.json", "json", (Put((0, "position", "x"), -1e308),))])
def test_texts_of_logs(changes: Input) -> None:
    TEXTS.check(changes)


@given(TABLES.inputs)
def test_tables_and_images_of_logs(changes: Input) -> None:
    TABLES.check(changes)


@given(PANDASET.inputs)
@example([In("log/lidar/00.pkl.gz", "unzipped", (Bytes(at=1979, length=1, data=b"H"),))])
def test_logs_of_pandaset(changes: Input) -> None:
    PANDASET.check(changes)


@given(IMAGES.inputs)
def test_recorded_images(changes: Input) -> None:
    IMAGES.check(changes)
