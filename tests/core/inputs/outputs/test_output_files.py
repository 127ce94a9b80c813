"""What programs write and read again with faults: records of rendered frames, sweeps, outputs of an
autonomy stack, recipes."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given

from inputs.faults import Array, CutOff, Drop, Put, Rename, Shape, Type
from inputs.promise import Property, Reader
from inputs.strategies import Input, inputs_of
from inputs.views import In, json_text, npz_file
from unisim_blender.core.evaluation.autonomy.document import read_outputs
from unisim_blender.core.evaluation.autonomy.measure import measure
from unisim_blender.core.formats.rendered import read_sweep
from unisim_blender.core.sequence.records import STATE_FOLDER, finished_moments, read_records, remove_files
from unisim_blender.core.sequence.run import TIMINGS_NAME, _read_timings
from unisim_street.street import Recipe, load_street, recipe_document

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="no alarms and no bounds of memory there")


def record_reader(folder: Path) -> Reader:
    """What a folder of rendered frames says of itself: a record that is broken counts as none, and names
    no file elsewhere."""
    out = folder / "out"
    record, kept = f"out/{STATE_FOLDER}/000001.json", f"out/{STATE_FOLDER}/000002.kept"
    files = {"a.png": "0" * 64, "b/a.exr": "x"}
    camera = {"identity": "k", "files": files, "sees": ["car"], "samples": {"rays": 1}, "max_error": None}
    document = {"frame": 1, "captures": {"camera/a": camera, "labels": {**camera, "files": {"a.json": "0" * 64}}}}
    bounded = {**camera, "max_error": {"kept": True, "settings": "fast"}}
    whole = {
        record: json_text(document), kept: json_text({"frame": 2, "captures": {"camera/a": bounded}}),
        "precious": b"mine",
        f"out/{TIMINGS_NAME}": json_text({"1": {"a": 0.1}}),
    }  # fmt: skip

    def read() -> object:
        found = read_records(out)
        finished_moments(out, range(3))
        for captures in found.values():
            for one in captures.values():
                one.is_whole(out)
                remove_files(out, one)
        assert (folder / "precious").read_bytes() == b"mine", "a file beside the folder was removed"
        return found, _read_timings(out)

    changed = {name: data for name, data in whole.items() if name != "precious"}
    views = {name: ["json"] for name in changed}
    return Reader(folder, whole, read, inputs_of(changed, views), (), keeps=False, refuses=False)


def sweep_reader(folder: Path) -> Reader:
    """A rendered sweep, of which a log is made."""
    n = 5
    arrays: dict[str, Any] = {axis: np.arange(n, dtype=np.float32) for axis in "xyz"} | {
        "time": np.linspace(0, 0.1, n), "intensity": np.full(n, 0.5, np.float32), "ring": np.arange(n, dtype=np.int32),
        "world_from_lidar": np.eye(4),
    }  # fmt: skip
    whole = {"sweep.npz": npz_file(arrays)}

    def read() -> object:
        sweep = read_sweep(folder / "sweep.npz")
        rows = len(sweep.points)
        assert sweep.points.shape == sweep.origins.shape == (rows, 3) and np.isfinite(sweep.points).all()
        assert sweep.time_s.shape == sweep.intensity.shape == sweep.ring.shape == (rows,)
        return sweep

    return Reader(folder, whole, read, inputs_of(whole, {"sweep.npz": ["npz"]}), ("sweep.npz",))


def metrics_reader(folder: Path) -> Reader:
    """Outputs of an autonomy stack, compared with themselves."""
    box = {"box": [10, 2, 4, 2, 0.1], "score": 0.9, "class": "Car"}
    box |= {"modes": [{"probability": 1.0, "positions": [[1, 2], [3, 4]]}]}
    frame = {"sequence": "001", "frame": 0, "boxes": [box, {**box, "ignored": True}], "plan": [[0, 1], [2, 3]]}
    document = {"format": "unisim-autonomy", "version": 1, "boxes": "bev", "frames": [frame, {**frame, "frame": 1}]}
    whole = {"outputs.json": json_text(document)}

    def read() -> object:
        outputs = read_outputs(folder / "outputs.json")
        return measure(outputs, outputs)

    return Reader(folder, whole, read, inputs_of(whole, {"outputs.json": ["json"]}), ("outputs.json",))


def recipe_reader(folder: Path) -> Reader:
    """A street's recipe, which is small, and the street of it."""
    recipe = Recipe(frames=32, width=16, height=16, speed_m_s=40.0, turns_deg=(-5.0,), lens="mei")
    whole = {"street.json": json_text(recipe_document(recipe))}
    return Reader(
        folder,
        whole,
        lambda: load_street(folder / "street.json"),
        inputs_of(whole, {"street.json": ["json"]}),
        ("street.json",),
    )


RECORDS, SWEEPS = Property(record_reader), Property(sweep_reader)
METRICS, RECIPES = Property(metrics_reader), Property(recipe_reader)
RECORD = f"out/{STATE_FOLDER}/000001.json"


@given(RECORDS.inputs)
@example([In(RECORD, "json", (Put(("captures", "camera/a", "files", "../precious"), "x"),))])
@example([In(RECORD, "json", (Put(("captures", "camera/a", "samples", "rays"), []),))])
def test_records_of_rendered_frames(changes: Input) -> None:
    RECORDS.check(changes)


@given(SWEEPS.inputs)
@example([In("sweep.npz", "npz", (Drop(("intensity",)),))])
@example([In("sweep.npz", "npz", (Array("x", Shape("a scalar")),))])
@example([In("sweep.npz", "npz", (Array("time", Shape("rows", 1)),))])
@example([In("sweep.npz", "npz", (Array("world_from_lidar", Shape("columns", 1)),))])
@example([In("sweep.npz", "npz", (Array("y", Type("O")),))])
@example([In("sweep.npz", "bytes", (CutOff(0),))])
@example([In("sweep.npz", "bytes", (CutOff(200),))])
def test_rendered_sweeps(changes: Input) -> None:
    SWEEPS.check(changes)


@given(METRICS.inputs)
@example([In("outputs.json", "json", (Rename(("frames", 0, "sequence"), "\n", False),))])
def test_outputs_of_an_autonomy_stack(changes: Input) -> None:
    METRICS.check(changes)


@given(RECIPES.inputs)
def test_recipes_of_streets(changes: Input) -> None:
    RECIPES.check(changes)
