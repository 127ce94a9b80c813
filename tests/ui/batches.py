"""The panel Batch with mouse and keys: a parameter by the search, a batch, cancelled and gone on with. Run by `run.py`."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

sys.path.insert(0, str(Path(__file__).parent))
from buttons import CROSS, open_panel, place_of, press, typed
from edit_panel import module, moved_along, picked
from hands import key, write
from session import OUT, screenshot, start, until
from tasks import imported, seen, task, told

FOLDER = OUT.parent / "batch"


def about() -> Any:
    """The settings of the scene's batches; undo leaves no other hold on them."""
    return bpy.context.scene.unisim_batch


def parameter() -> Iterator[float]:
    """A car is moved; the place of it is chosen in the search of Add Parameter, and its count is typed."""
    yield from picked(seen(driving=False))
    yield from moved_along(("G",), ("Y",), ("TWO", "2"), ("RET",))
    scene = bpy.context.scene
    scene.unisim.quality, scene.unisim.sequence_width, scene.unisim.sequence_sensors = "fast", 96, "CAMERA"
    scene.frame_end = scene.frame_start + 1
    about().out, about().jobs = str(FOLDER), 1
    yield from open_panel("Batch", "unisim_batch.jobs", 0.75)
    yield from press("unisim.add_parameter(")
    yield 1.0
    yield from write("along y")
    yield 1.0
    screenshot("batch_search")
    yield from key("RET")
    yield from until(lambda: len(about().parameters) == 1, "no parameter is added", 10)
    one = about().parameters[0]
    assert one.about.endswith(": place along y (m)") and one.kind == "RANGE", (one.about, one.kind)
    one.stop = one.start + 1.0
    yield from typed("parameters[0].count", "4")
    yield from until(lambda: about().parameters[0].count == 4, "the count is not taken over", 10)
    screenshot("batch_panel")


def run() -> Iterator[float]:
    """Submit, cancelled and pressed again; the report is there, with the four variants."""
    yield from press("unisim.submit_batch()")
    yield from until(lambda: "units" in told(), f"no progress is shown: {told()}", 120)
    screenshot("batch_running")
    yield from press("unisim.cancel_task()", columns=(CROSS,))
    yield from until(lambda: told().startswith(("Stopped at", "Done")), f"Cancel is not answered: {told()}", 60)
    yield 1.0
    yield from press("unisim.submit_batch()")
    yield from until(lambda: told().startswith("Done"), f"the batch does not end: {told()}", 300)
    yield 1.0
    manifest = json.loads((FOLDER / "manifest.json").read_bytes())
    assert len(manifest["variants"]) == 4 and manifest["unfinished"] == []
    assert module("features.batch.operators").report_path(bpy.context.scene) == FOLDER / "report.html"
    assert bpy.ops.unisim.open_report.poll()
    yield from place_of("unisim.open_report()")
    screenshot("batch_done")


def steps() -> Iterator[float]:
    """The session."""
    yield from imported()
    for name, todo in (("batch_parameter", parameter), ("batch_run", run)):
        yield from task(name, todo)


if __name__ == "__main__":
    start(steps(), "batches")
