"""Lamps of a street's actors: found in the background, set and keyed, exported, imported again, and shown in images."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import copytree
from typing import Any

import bpy
import pytest
from edit_cases import lines, press
from helpers import driving, imported, read, select
from written_street import write_recipe

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.scenario.edits import Lamp
from unisim_blender.core.world.encoding import decode_state
from unisim_blender.editing.reading.requests import camera_request
from unisim_blender.editing.reading.scenario import edited_ids
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.source import lamps_of
from unisim_blender.features.actors.lamps import LampTask
from unisim_blender.process.background import newest

LAMPS = {("car-01", "amber left"), ("car-01", "red"), ("traffic-light", "red-green")}
EDITS: list[dict[str, Any]] = [
    {"type": "lamp", "actor": "traffic-light", "state": "green"},
    {"type": "lamp", "actor": "car-01", "lamp": "red", "state": "off", "from_s": 0.5, "to_s": 1.2},
    {"type": "lamp", "actor": "car-01", "lamp": "red", "state": "on", "from_s": 1.2, "to_s": 1.5},
]


@pytest.fixture(scope="module")
def log_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_recipe(tmp_path_factory.mktemp("lamps") / "log", seed=0, frames=20, width=480, height=270, lamps=True)


@pytest.fixture
def new_log(log_path: Path, tmp_path: Path) -> Path:
    """A copy of the log, whose lamps nobody has found."""
    copytree(log_path, tmp_path / "log")
    return tmp_path / "log"


def stated(log: Path, edits: list[dict[str, Any]]) -> str:
    """A scenario's file with edits of a log."""
    path = log.parent / "lamps.json"
    document = {"format": "unisim-scenario", "version": 1, "name": "lamps", "log": str(log), "edits": edits}
    path.write_text(json.dumps(document))
    return str(path)


def image(scene: Any, frame: float) -> tuple[dict[str, dict[str, str]], list[str]]:
    """The states of lamps that an image of a frame is asked for with, by actor and name, and warnings."""
    sampled, source = sample_all(scene, Clock.of(source_of(scene).drive)), source_of(scene)
    view = next(obj for obj in sampled.objects if obj.kind == "CAMERA")
    values = camera_request(sampled, view, source, frame, (64, 36)).values
    actors = decode_state(values["state"]).actors
    lamps = {a.uid: {lamp.name: lamp.states[lamp.shown[0]] for lamp in a.lamps} for a in actors if a.lamps}
    return lamps, [str(warning) for warning in values["warnings"]]


def key(scene: Any, number: int, *keys: tuple[int, str]) -> None:
    """Key a lamp as a person does."""
    for frame, state in keys:
        scene.unisim_lamps[number].state = state
        assert scene.keyframe_insert(f"unisim_lamps[{number}].state", frame=frame)


def test_lamps_are_found_keyed_and_exported(scene: Any, log_path: Path, tmp_path: Path) -> None:
    assert bpy.ops.unisim.import_log(directory=str(log_path)) == {"FINISHED"}
    assert bpy.ops.unisim.find_lamps() == {"FINISHED"}
    assert newest[LampTask].fraction == 1.0
    lamps = {(lamp.actor, lamp.name): number for number, lamp in enumerate(scene.unisim_lamps)}
    assert set(lamps) == LAMPS and read(scene).edits == () and lines(scene) == ()
    recorded = json.loads(scene.unisim_lamps[lamps["traffic-light", "red-green"]].recorded)
    assert [state for state, _ in recorded] == ["red", "green"] and recorded[1][1] == pytest.approx(0.9, abs=0.06)
    # one of them keyed, one throughout
    key(scene, lamps["car-01", "red"], (0, "recorded"), (5, "off"), (8, "off"), (12, "on"), (15, "recorded"))
    scene.unisim_lamps[lamps["traffic-light", "red-green"]].state = "green"
    wanted = [Lamp(**{name: value for name, value in edit.items() if name != "type"}) for edit in EDITS]
    wanted[0] = Lamp("traffic-light", "green", "red-green")
    edits = read(scene).edits
    assert sorted(map(str, edits)) == sorted(map(str, wanted))
    told = {line.uid: (line.part, line.what, line.frames[0], line.frames[-1]) for line in lines(scene)}
    assert told == {
        "car-01": ("LAMP", "Red: Off, Red: On", 5, 14), "traffic-light": ("LAMP", "Red-Green: Green", 0, 19)
    }  # fmt: skip
    assert edited_ids(sample_all(scene, Clock.of(source_of(scene).drive)), source_of(scene).drive) == set(told)
    assert image(scene, 9) == ({"car-01": {"red": "off"}, "traffic-light": {"red-green": "green"}}, [])
    assert image(scene, 13)[0]["car-01"] == {"red": "on"} and image(scene, 17)[0]["car-01"] == {"red": "off"}
    # lamps of a removed actor are none of the scenario's
    select(imported(scene, "ACTOR", "traffic-light"))
    bpy.ops.unisim.delete_actor()
    assert {edit.actor for edit in read(scene).edits if isinstance(edit, Lamp)} == {"car-01"}
    # the export is imported with lamps that are known, and exported the same
    file = tmp_path / "out.json"
    assert bpy.ops.unisim.export_scenario(filepath=str(file)) == {"FINISHED"}
    before = read(scene).edits
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.ops.unisim.import_scenario(filepath=str(file)) == {"FINISHED"}
    assert {(lamp.actor, lamp.name) for lamp in bpy.context.scene.unisim_lamps} >= LAMPS - {
        ("traffic-light", "red-green")
    }
    assert read(bpy.context.scene).edits == before


def test_a_scenario_shows_lamps_before_they_are_found(scene: Any, new_log: Path) -> None:
    assert bpy.ops.unisim.import_scenario(filepath=stated(new_log, EDITS)) == {"FINISHED"}
    assert [(lamp.actor, lamp.name, lamp.recorded) for lamp in scene.unisim_lamps] == [
        ("traffic-light", "", ""), ("car-01", "red", "")
    ]  # fmt: skip
    scene.frame_set(9)
    assert [lamp.state for lamp in scene.unisim_lamps] == ["green", "off"]
    assert [edit.type for edit in read(scene).edits] == ["lamp"] * 3
    lamps, warnings = image(scene, 9)
    assert lamps == {} and "Find Lamps" in warnings[-1]
    assert bpy.ops.unisim.find_lamps() == {"FINISHED"}
    assert {(lamp.actor, lamp.name) for lamp in scene.unisim_lamps} == LAMPS
    assert image(scene, 9) == ({"car-01": {"red": "off"}, "traffic-light": {"red-green": "green"}}, [])


def test_an_image_that_cannot_be_read_is_said(scene: Any, new_log: Path) -> None:
    assert bpy.ops.unisim.import_log(directory=str(new_log)) == {"FINISHED"}
    broken = sorted(new_log.glob("camera/*/*.jpg"))[0]
    broken.write_bytes(b"none")
    with pytest.raises(RuntimeError, match=broken.name):
        bpy.ops.unisim.find_lamps()
    assert len(scene.unisim_lamps) == 0


def test_a_state_that_no_lamp_has_is_refused(scene: Any, street_log: Path) -> None:
    edit = {"type": "lamp", "actor": "car-01", "state": "blue"}
    with pytest.raises(RuntimeError, match='no lamp is "blue"'):
        bpy.ops.unisim.import_scenario(filepath=stated(street_log, [edit]))


def test_a_variant_has_lamps_of_its_own_and_a_removal_is_muted_beside_them(street: Any) -> None:
    uid = driving(street).unisim.uid
    item = street.unisim_lamps.add()
    item.actor, item.name = uid, "red"
    key(street, 0, (0, "recorded"), (4, "on"))
    assert bpy.ops.unisim.new_variant(name="other") == {"FINISHED"}
    other = bpy.context.scene
    assert other != street and read(other).edits == read(street).edits == (Lamp(uid, "on", "red", 0.4),)
    key(other, 0, (4, "off"))
    assert [edit.state for scene in (other, street) for edit in read(scene).edits] == ["off", "on"]  # type: ignore[attr-defined]
    select(driving(other))
    bpy.ops.unisim.delete_actor()
    (line,) = lines(other)
    assert line.part == "REMOVE" and [edit.type for edit in read(other).edits] == ["remove"]
    for parts in (["LAMP", "REMOVE"], ["REMOVE"]):
        press(bpy.ops.unisim.mute_edit, next(line for line in lines(other) if line.part == "REMOVE"))
        assert sorted(line.part for line in lines(other)) == parts


def test_lamps_are_found_in_the_world_of_a_trained_scene(logged_street: Any) -> None:
    assert lamps_of(source_of(logged_street)) is None
    assert bpy.ops.unisim.find_lamps() == {"FINISHED"}
    assert lamps_of(source_of(logged_street)) == {} and len(logged_street.unisim_lamps) == 0
