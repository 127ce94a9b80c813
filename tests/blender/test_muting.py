"""Muted edits: the drive stands as recorded, the edit is in the file, and unmuting brings it back as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from edit_cases import CASES, lines, press, standing, update
from helpers import content, driving, read, select

from unisim_blender.bridge.objects.imported import imported_objects, is_copy, source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import same


def mute(scene: Any, number: int = 0) -> None:
    """Press the eye of a line."""
    press(bpy.ops.unisim.mute_edit, lines(scene)[number])


def as_recorded(scene: Any) -> None:
    """Every recorded actor stands where it was recorded, at every frame."""
    drive = source_of(scene).drive
    clock = Clock.of(drive)
    sampled = {one.uid: one for one in sample_all(scene, clock).of("ACTOR")}
    assert set(sampled) == set(drive.actors)
    for uid, actor in drive.actors.items():
        poses = actor.world_from_actor.at(clock.times_s if actor.is_moving else np.zeros(len(clock.times_s)))
        assert same(sampled[uid].poses, poses)[sampled[uid].there].all(), uid
        assert sampled[uid].there.any()


@pytest.mark.parametrize("name", CASES)
def test_muted_and_unmuted_is_the_same_scenario(street: Any, name: str) -> None:
    make, part, _ = CASES[name]
    make(street)
    update()
    before, line = content(read(street)), lines(street)[0]
    shown = {one.name for one in street.objects}
    mute(street)
    assert content(read(street)) == ([], None, {})
    as_recorded(street)
    (muted,) = lines(street)
    assert muted.muted == 0 and (muted.key, muted.what, muted.who) == (line.key, line.what, line.who)
    assert muted.start_s == pytest.approx(line.start_s) and muted.frames[0] == line.frames[0]
    mute(street)
    (again,) = lines(street)
    assert content(read(street)) == before
    assert again.muted == -1 and again.key == line.key and again.what == line.what
    assert {one.name for one in street.objects} == shown
    assert not [one.name for one in bpy.data.objects if "muted" in one.name]


@pytest.mark.parametrize("name", CASES)
def test_muted_survives_saving(street: Any, name: str, tmp_path: Path) -> None:
    CASES[name][0](street)
    update()
    before = content(read(street))
    mute(street)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "muted.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "muted.blend"))
    scene = bpy.context.scene
    (line,) = lines(scene)
    assert line.muted == 0 and content(read(scene)) == ([], None, {})
    mute(scene)
    assert content(read(scene)) == before


@pytest.mark.parametrize(
    "name", ("moved", "hidden", "removed", "copied", "swapped", "ego", "camera moved", "mesh", "item moved")
)
def test_a_muted_edit_can_be_reverted(street: Any, name: str) -> None:
    CASES[name][0](street)
    update()
    mute(street)
    press(bpy.ops.unisim.revert_edit, lines(street)[0])
    assert lines(street) == () and content(read(street)) == ([], None, {})
    assert not [one.name for one in bpy.data.objects if "muted" in one.name]


def test_undo_and_redo(street: Any) -> None:
    driving(street).location.y = 3.0
    update()
    before = content(read(street))
    bpy.ops.ed.undo_push(message="moved")
    mute(street)
    bpy.ops.ed.undo_push(message="muted")
    mute(bpy.context.scene)
    bpy.ops.ed.undo_push(message="unmuted")
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert [line.muted for line in lines(scene)] == [0] and content(read(scene)) == ([], None, {})
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert [line.muted for line in lines(scene)] == [-1] and content(read(scene)) == before
    bpy.ops.ed.redo()
    scene = bpy.context.scene
    assert [line.muted for line in lines(scene)] == [0] and content(read(scene)) == ([], None, {})
    mute(scene)
    assert content(read(scene)) == before


def test_a_copy_of_an_object_with_a_muted_edit(street: Any) -> None:
    one = driving(street)
    one.location.y = 3.0
    update()
    mute(street)
    select(driving(street))
    bpy.ops.object.duplicate_move(TRANSFORM_OT_translate={"value": (0.0, 5.0, 0.0)})
    copy = bpy.context.active_object
    assert is_copy(street, copy)
    found = {line.part: line for line in lines(street)}
    assert found["MOVE"].muted == 0 and found["COPY"].object_name == copy.name and found["COPY"].muted == -1
    press(bpy.ops.unisim.mute_edit, found["MOVE"])
    found = {line.part: line for line in lines(street)}
    assert (
        found["MOVE"].muted == -1
        and found["MOVE"].what == "Moved 3.0 m left"
        and found["COPY"].object_name == copy.name
    )
    assert driving(street).location.y == pytest.approx(3.0)


def test_unmuting_mutes_what_cannot_stand_beside_it(street: Any) -> None:
    driving(street).location.y = 3.0
    mute(street)
    driving(street).location.y = -1.0
    found = {line.muted: line for line in lines(street)}
    assert found[-1].what == "Moved 1.0 m right" and found[0].what == "Moved 3.0 m left"
    press(bpy.ops.unisim.mute_edit, found[0])
    found = {line.muted: line for line in lines(street)}
    assert found[-1].what == "Moved 3.0 m left" and found[0].what == "Moved 1.0 m right"
    select(driving(street))
    bpy.ops.unisim.delete_actor()
    found = {line.muted: line for line in lines(street)}
    assert found[-1].part == "REMOVE"
    press(bpy.ops.unisim.mute_edit, found[0])
    muted = {line.what: line.muted for line in lines(street)}
    assert muted["Moved 1.0 m right"] == -1 and muted["Removed"] == 0
    assert driving(street).location.y == pytest.approx(-1.0)


def test_one_edit_of_two_is_muted_alone(street: Any) -> None:
    select(driving(street))
    bpy.ops.unisim.replace_appearance(appearance="car-02")
    driving(street).location.y += 3.0
    update()
    before = content(read(street))
    found = {line.part: line for line in lines(street)}
    press(bpy.ops.unisim.mute_edit, found["MOVE"])
    (edit,) = read(street).edits
    assert type(edit).__name__ == "Swap"
    press(bpy.ops.unisim.mute_edit, next(line for line in lines(street) if line.part == "APPEARANCE"))
    assert read(street).edits == ()
    press(bpy.ops.unisim.mute_edit, next(line for line in lines(street) if line.part == "MOVE"))
    (edit,) = read(street).edits
    assert type(edit).__name__ == "Move"
    press(bpy.ops.unisim.mute_edit, next(line for line in lines(street) if line.part == "APPEARANCE"))
    assert content(read(street)) == before


def test_sensors_stay_on_the_vehicle_when_its_edit_is_muted(street: Any) -> None:
    bpy.ops.unisim.shift_ego(left_m=2.0)
    mute(street)
    mute(street)
    (vehicle,) = imported_objects(street, "EGO")
    for sensor in imported_objects(street, "CAMERA", "LIDAR"):
        above = sensor.parent if sensor.parent.unisim.kind == "EGO" else sensor.parent.parent
        assert above == vehicle
    assert street.camera is not None and street.camera.unisim.kind == "CAMERA"


def test_a_muted_camera_makes_way(street: Any) -> None:
    CASES["camera added"][0](street)
    added = street.camera.name
    mute(street)
    assert street.camera is not None and street.camera.name != added
    assert added not in street.objects


def test_selection_stays(street: Any) -> None:
    one = driving(street)
    one.location.y = 3.0
    select(one)
    mute(street)
    mute(street)
    assert bpy.context.selected_objects == [driving(street)] and bpy.context.active_object == driving(street)
    assert standing(street) not in bpy.context.selected_objects


def test_importing_again_keeps_a_muted_edit(street: Any) -> None:
    from helpers import SAMPLE

    driving(street).location.y = 3.0
    update()
    before = content(read(street))
    mute(street)
    assert bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json")) == {"FINISHED"}
    assert [line.muted for line in lines(street)] == [0]
    mute(street)
    assert content(read(street)) == before


def test_an_imported_scenario_is_muted_unmuted_and_reverted(scene: Any) -> None:
    from helpers import SAMPLE

    assert bpy.ops.unisim.import_scenario(filepath=str(SAMPLE / "scenario.json")) == {"FINISHED"}
    update()
    before = content(read(scene))
    told = [(line.key, line.what) for line in lines(scene)]
    assert len(told) >= 4 and not any(line.part == "PROBLEM" for line in lines(scene))
    for key, _ in told:
        press(bpy.ops.unisim.mute_edit, next(line for line in lines(scene) if line.key == key and line.muted < 0))
    assert content(read(scene)) == ([], None, {})
    for key, _ in reversed(told):
        press(bpy.ops.unisim.mute_edit, next(line for line in lines(scene) if line.key == key))
    assert content(read(scene)) == before
    assert [(line.key, line.what) for line in lines(scene)] == told
    while found := lines(scene):
        press(bpy.ops.unisim.revert_edit, found[0])
    assert content(read(scene)) == ([], None, {})
