"""A file of boxes is imported as a log, and given to a log as it is imported."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import pytest
from small_log import small_drive, write_small_log

from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.tracks.box_file import Track, write_boxes
from unisim_blender.editing.sampled.source import open_source


def actors() -> list[str]:
    """The ids of the actors that are imported."""
    return sorted(item.unisim.uid for item in bpy.context.scene.objects if item.unisim.kind == "ACTOR")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A log with three actors, a copy without any, and this one's boxes."""
    drive = small_drive()
    write_small_log(tmp_path / "labelled", drive)
    write_small_log(tmp_path / "bare", replace(drive, actors={}))
    tracks = [Track(drive.actors[uid]) for uid in ("car-1", "van")]
    write_boxes(tmp_path / "bare.boxes.json", open_log(tmp_path / "bare"), tracks, "a test")
    return tmp_path


def test_a_file_of_boxes_is_imported_as_a_log(scene: Any, folder: Path) -> None:
    path = folder / "bare.boxes.json"
    assert bpy.ops.unisim.import_drive(filepath=str(path)) == {"FINISHED"}
    assert actors() == ["car-1", "van"]
    assert bpy.ops.unisim.export_scenario(filepath=str(folder / "scenario.json")) == {"FINISHED"}
    assert json.loads((folder / "scenario.json").read_text())["log"] == path.name
    document = json.loads(path.read_text())
    del document["tracks"][0]
    path.write_text(json.dumps(document))
    assert list(open_source(str(path), "").drive.actors) == ["van"]  # the file has changed


def test_a_log_is_imported_with_the_boxes_of_a_file(scene: Any, folder: Path) -> None:
    boxes = str(folder / "bare.boxes.json")
    assert bpy.ops.unisim.import_drive(filepath=str(folder / "labelled"), boxes=boxes) == {"FINISHED"}
    assert actors() == ["car-1", "van"] and scene.unisim.log.endswith("bare.boxes.json")
    (folder / "broken.json").write_text("{")
    with pytest.raises(RuntimeError, match="broken.json: is no file of boxes"):
        bpy.ops.unisim.import_log(filepath=str(folder / "labelled"), boxes=str(folder / "broken.json"))
