"""Files of an earlier version, commit fc98523, open as they were: a .blend, scenarios, the sample's scene.

`earlier/edited.blend` has a car that drives moved by 3 m, one deleted, one that stands moved, one scaled, one
duplicated, and the ego vehicle's lane shifted; `earlier/edited.json` is the scenario that it exported.
`earlier/swapped.json` calls an appearance ``look``. `earlier/drive.json` is the drive of the sample's scene at that time.
"""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from click.testing import CliRunner
from helpers import SAMPLE, assert_alike, drive_of

from unisim_blender.core.cli.main import unisim

EARLIER = Path(__file__).parent / "earlier"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """The earlier files beside the trained scene that they name; the log that it was trained on is not at hand."""
    target = tmp_path / "files"
    shutil.copytree(SAMPLE / "scene", target / "scene")
    header = json.loads((target / "scene" / "scene.json").read_text())
    header["drive"] = json.loads((EARLIER / "drive.json").read_text())
    (target / "scene" / "scene.json").write_text(json.dumps(header))
    for name in ("edited.blend", "edited.json", "swapped.json"):
        shutil.copy(EARLIER / name, target)
    return target


def close(one: Any, other: Any, place: str = "") -> None:
    """Assert that two documents are the same, numbers to a millionth."""
    assert type(one) is type(other) or {type(one), type(other)} <= {int, float}, place
    if isinstance(one, dict):
        assert one.keys() == other.keys(), place
        for key in one:
            close(one[key], other[key], f"{place}.{key}")
    elif isinstance(one, list):
        assert len(one) == len(other), place
        for number, pair in enumerate(zip(one, other, strict=True)):
            close(*pair, f"{place}[{number}]")
    elif isinstance(one, float | int) and not isinstance(one, bool):
        assert np.isclose(one, other, rtol=0, atol=2e-6), f"{place}: {one} and {other}"
    else:
        assert one == other, place


def test_an_earlier_blend_file_exports_the_scenario_that_it_did(addon: Any, folder: Path) -> None:
    bpy.ops.wm.open_mainfile(filepath=str(folder / "edited.blend"))
    assert bpy.ops.unisim.export_scenario("EXEC_DEFAULT", filepath=str(folder / "again.json")) == {"FINISHED"}
    again, earlier = (json.loads((folder / name).read_text()) for name in ("again.json", "edited.json"))
    assert {edit["type"] for edit in again["edits"]} == {"move", "remove", "scale", "duplicate", "ego"}
    assert_alike(drive_of(folder / "again.json"), drive_of(folder / "edited.json"))
    offset = again["edits"].pop(0)
    assert offset == {"type": "move", "actor": earlier["edits"].pop(0)["actor"], "offset_m": [0.0, 3.0, 0.0]}
    close(again, earlier)


def test_an_earlier_scenario_renders(folder: Path, tmp_path: Path) -> None:
    """With the edits in its labels: the deleted car is gone, the copy is there."""
    arguments = [
        "render",
        str(folder / "edited.json"),
        "--out",
        str(tmp_path / "out"),
        "--frames",
        "5",
        "--width",
        "64",
    ]
    result = CliRunner().invoke(unisim, [*arguments, "--sensors", "front_camera", "--jobs", "1"])
    assert result.exit_code == 0, result.output
    labels = json.loads((tmp_path / "out" / "labels" / "000005.json").read_text())
    boxes = {box["id"]: box for box in labels["boxes"]}
    assert "car-03" not in boxes and len(boxes) == 20


def test_an_earlier_appearance_opens_and_is_exported_by_its_name_of_now(addon: Any, scene: Any, folder: Path) -> None:
    assert bpy.ops.unisim.import_scenario(filepath=str(folder / "swapped.json")) == {"FINISHED"}
    assert bpy.ops.unisim.export_scenario("EXEC_DEFAULT", filepath=str(folder / "again.json")) == {"FINISHED"}
    again, earlier = (json.loads((folder / name).read_text()) for name in ("again.json", "swapped.json"))
    (swap,) = (edit for edit in again["edits"] if edit["type"] == "swap")
    assert earlier["edits"] == [{"type": "swap", "actor": "car-12", "look": "car-13"}]
    assert swap == {"type": "swap", "actor": "car-12", "appearance": "car-13"}
