"""Submit Batch: marked variants, parameters over fields of the scenario, and the batch that the command line makes."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import pytest
from edit_cases import standing
from helpers import driving_car

from unisim_blender.features.batch.operators import (
    BatchTask,
    batch_place,
    count_of,
    field_items,
    find_fields,
    jobs_folder,
    report_path,
)
from unisim_blender.process import background


@pytest.fixture(autouse=True)
def one_task() -> Iterator[None]:
    """No task is left over."""
    yield
    background.running.clear()
    background.newest.clear()


@pytest.fixture
def moved(street: Any) -> Any:
    """The street with a car moved aside, and settings of a batch of small images."""
    standing(street).location.y += 1.0
    bpy.context.view_layer.update()
    street.unisim.quality, street.unisim.sequence_sensors, street.unisim.sequence_width = "fast", "CAMERA", 32
    street.frame_start = street.frame_end = street.frame_current
    return street


def add(scene: Any, ending: str) -> Any:
    """Add a parameter by the field whose pointer ends so."""
    find_fields(scene)
    (at, *_) = [item[0] for item in field_items(None, bpy.context) if item[0].endswith(ending)]
    assert bpy.ops.unisim.add_parameter(at=at) == {"FINISHED"}
    return scene.unisim_batch.parameters[-1]


def test_parameters_are_chosen_among_the_fields(moved: Any) -> None:
    first = add(moved, "position/1")
    assert first.kind == "RANGE" and first.stop - first.start == pytest.approx(2.0), "not three equal values"
    assert first.name == first.about == f"{standing(moved).name}: place along y (m)"
    second = add(moved, "position/1")
    assert second.name == f"{first.about} 2"
    first.count = 4
    second.kind, second.values = "VALUES", "0, 1.5"
    assert count_of(moved) == 8
    assert bpy.ops.unisim.remove_parameter(index=0) == {"FINISHED"}
    assert [one.name for one in moved.unisim_batch.parameters] == [f"{first.about} 2"] and count_of(moved) == 2


def test_what_a_shift_made_is_offered(street: Any) -> None:
    one = driving_car(street)
    bpy.ops.unisim.shift_actor(left_m=1.25, ahead_m=0.0, later_s=0.6)
    later = add(street, "later_s")
    assert (later.name, later.start, later.stop) == (f"{one.name}: later (s)", pytest.approx(-0.4), pytest.approx(1.6))
    labels = [label for _, label, _ in field_items(None, bpy.context)]
    assert f"{one.name}: left (m) = 1.25" in labels and f"{one.name}: later (s) = 0.6" in labels


def test_the_button_says_what_is_missing(street: Any, tmp_path: Path) -> None:
    about = street.unisim_batch
    assert not bpy.ops.unisim.submit_batch.poll(), "the .blend was never saved"
    about.out = str(tmp_path / "batch")
    assert bpy.ops.unisim.submit_batch.poll() and not bpy.ops.unisim.open_report.poll()
    assert jobs_folder(street) == tmp_path / "batch jobs"
    street.unisim_edits.rendered = False
    assert not bpy.ops.unisim.submit_batch.poll()
    street.unisim_edits.rendered = True
    about.driven, street.unisim_simulation.choice = True, "MODULE"
    assert not bpy.ops.unisim.submit_batch.poll()
    about.driven, about.out = False, "s3://bucket/batch"
    assert batch_place(street) == "s3://bucket/batch" and not bpy.ops.unisim.submit_batch.poll()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    assert bpy.ops.unisim.submit_batch.poll() and jobs_folder(street) == tmp_path / "batch jobs"


def test_a_batch_of_a_parameter_is_rendered_and_resumed(moved: Any, tmp_path: Path) -> None:
    about = moved.unisim_batch
    about.out, about.jobs = str(tmp_path / "batch"), 1
    parameter = add(moved, "position/1")
    parameter.name, parameter.stop, parameter.count = "aside", parameter.start + 0.5, 2
    assert bpy.ops.unisim.submit_batch() == {"FINISHED"}
    task = background.newest[BatchTask]
    assert isinstance(task, BatchTask) and (task.problem, task.failed, task.fraction) == ("", 0, 1.0)
    manifest = json.loads((tmp_path / "batch" / "manifest.json").read_bytes())
    values = [one["parameters"]["aside"] for one in manifest["variants"].values()]
    assert values == pytest.approx([parameter.start, parameter.start + 0.5], abs=1e-4) and manifest["unfinished"] == []
    assert len(list((tmp_path / "batch" / "captures").rglob("*.png"))) >= 1
    assert report_path(moved) == tmp_path / "batch" / "report.html" and bpy.ops.unisim.open_report.poll()
    assert bpy.ops.unisim.submit_batch() == {"FINISHED"}
    again = background.newest[BatchTask]
    assert isinstance(again, BatchTask) and (again.reused, again.finished, again.fraction) == (task.finished, 0, 1.0)
    parameter.values, parameter.kind = "wide", "VALUES"
    with pytest.raises(RuntimeError, match="aside = .wide.*is not of type"):
        bpy.ops.unisim.submit_batch()


def test_progress_counts_what_the_command_tells(addon: Any, tmp_path: Path) -> None:
    task = BatchTask([], tmp_path, "")
    assert (task.fraction, task.measure()) == (0.0, "Checking scenarios")
    events = (
        {"event": "start", "units": 4, "kept": 1},
        {"event": "unit", "failure": None},
        {"event": "unit", "failure": "the disk is full"},
    )
    task._hear([*(json.dumps(event).encode() for event in events), b'{"event": "unit", "fail'])
    assert (task.done, task.fraction, task.measure()) == (3.0, 0.75, "3 of 4 units, 1 failed")
