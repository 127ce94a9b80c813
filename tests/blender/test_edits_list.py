"""The edits list: each edit is a line, a click goes there, and reverting leaves the drive as it was imported."""

from __future__ import annotations

import random
import time
from typing import Any

import bpy
import numpy as np
import pytest
from edit_cases import CASES, lines, press, standing, update
from helpers import driving, read, select

from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.sampling import adjacent_frames, edit_list, from_keys
from unisim_blender.bridge.sampling.edit_list import read_steps, reading_of
from unisim_blender.bridge.sampling.from_keys import Sampler
from unisim_blender.bridge.sampling.stepping import sample_all, shown_names
from unisim_blender.editing.edits.lines import EditLine
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import same
from unisim_blender.editing.texts import wrapped
from unisim_blender.features.edits import watch as edit_watch
from unisim_blender.features.edits.panel import draw_line


def test_an_imported_drive_has_no_edits(street: Any) -> None:
    assert lines(street) == ()


@pytest.mark.parametrize("name", CASES)
def test_an_edit_is_a_line(street: Any, name: str) -> None:
    make, part, words = CASES[name]
    make(street)
    (line,) = lines(street)
    assert line.part == part
    assert line.what.startswith(words), line.what
    drive = source_of(street).drive
    assert min(drive.time_s.values()) - 1e-6 <= line.start_s <= line.end_s <= max(drive.time_s.values()) + 1e-6
    scenario = read(street)
    assert len(scenario.edits) + (scenario.sensors is not None) + (part == "MOVE" and line.kind == "STATIC") * -1 == 1


@pytest.mark.parametrize("name", CASES)
def test_revert_leaves_an_empty_scenario(street: Any, name: str) -> None:
    camera, count = street.camera.name, len(list(imported_objects(street, "ACTOR", "EGO", "CAMERA", "LIDAR")))
    CASES[name][0](street)
    (line,) = lines(street)
    press(bpy.ops.unisim.revert_edit, line)
    assert lines(street) == ()
    scenario = read(street)
    assert scenario.edits == () and scenario.sensors is None
    assert street.camera is not None and street.camera.name == camera
    assert len(list(imported_objects(street, "ACTOR", "EGO", "CAMERA", "LIDAR"))) == count


def test_a_reverted_actor_drives_as_recorded_again(street: Any) -> None:
    one = driving(street)
    uid = one.unisim.uid
    select(one)
    bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.6)
    one.location.y = 2.0
    one.scale = (1.0, 1.0, 1.0)
    (line,) = lines(street)
    assert line.what == "Retimed: 0.6 s later; moved 2.0 m left"
    press(bpy.ops.unisim.revert_edit, line)
    street.frame_set(7)
    recorded = source_of(street).drive.actors[uid].world_from_actor.at(source_of(street).drive.time_s[7])
    assert same(np.array(driving(street).matrix_world, float), recorded)


def test_one_edit_of_two_is_reverted_alone(street: Any) -> None:
    select(driving(street))
    bpy.ops.unisim.replace_appearance(appearance="car-02")
    driving(street).location.y += 3.0
    found = {line.part: line for line in lines(street)}
    assert set(found) == {"APPEARANCE", "MOVE"} and found["MOVE"].what == "Moved 3.0 m left"
    press(bpy.ops.unisim.revert_edit, found["APPEARANCE"])
    (line,) = lines(street)
    assert line.part == "MOVE" and line.what == "Moved 3.0 m left"
    assert len(read(street).edits) == 1
    select(driving(street))
    bpy.ops.unisim.replace_appearance(appearance="car-02")
    press(bpy.ops.unisim.revert_edit, next(line for line in lines(street) if line.part == "MOVE"))
    (line,) = lines(street)
    assert line.part == "APPEARANCE"


@pytest.mark.parametrize("first", ["MOVE", "SCALE"])
def test_a_move_and_a_scale_are_reverted_and_muted_apart(street: Any, first: str) -> None:
    driving(street).location.y = 3.0
    driving(street).scale = (1.3, 1.3, 1.3)
    whole = read(street)
    found = {line.part: line for line in lines(street)}
    assert set(found) == {"MOVE", "SCALE"}
    press(bpy.ops.unisim.mute_edit, found[first])
    assert [line.part for line in lines(street) if line.muted < 0] == [part for part in found if part != first]
    press(bpy.ops.unisim.mute_edit, next(line for line in lines(street) if line.muted >= 0))
    assert read(street).edits == whole.edits
    press(bpy.ops.unisim.revert_edit, next(line for line in lines(street) if line.part == first))
    assert [line.part for line in lines(street)] == [part for part in found if part != first]


def test_a_click_selects_the_object_and_goes_to_its_frames(street: Any) -> None:
    one = driving(street)
    for frame, left in ((0, 0.0), (10, 0.0), (15, 1.0), (19, 0.0)):
        street.frame_set(frame)
        one.location.y = left
        one.keyframe_insert("location", frame=frame)
    street.frame_set(2)
    select(standing(street))
    (line,) = lines(street)
    assert 10 <= line.frames[0] <= 11 and line.frames[-1] <= 18
    press(bpy.ops.unisim.go_to_edit, line)
    assert street.frame_current == line.frames[0]
    assert bpy.context.selected_objects == [driving(street)] and bpy.context.active_object == driving(street)


def test_a_click_on_a_removed_actor_selects_nothing(street: Any) -> None:
    select(standing(street))
    CASES["removed"][0](street)
    (line,) = lines(street)
    press(bpy.ops.unisim.go_to_edit, line)
    assert not bpy.context.selected_objects


def test_what_cannot_be_read_is_said_in_the_list(street: Any) -> None:
    standing(street).scale = (-1.0, 1.0, 1.0)
    driving(street).location.y = 1.0
    problem, line = lines(street)
    assert (
        problem.part == "PROBLEM"
        and problem.what.startswith("Is mirrored")
        and problem.object_name == standing(street).name
    )
    assert line.part == "MOVE"


def test_changes_mark_the_list_as_stale(street: Any) -> None:
    lines(street)
    assert reading_of(street).fresh
    driving(street).location.y = 1.0
    update()
    assert not reading_of(street).fresh
    steps = read_steps(street)
    next(steps)
    assert reading_of(street).busy and not reading_of(street).fresh
    for _ in steps:
        pass
    assert reading_of(street).fresh and len(reading_of(street).lines) == 1


def test_what_did_not_change_is_not_sampled_again(street: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    lines(street)
    sampled: list[str] = []
    before = Sampler.sample

    def noted(self: Sampler, obj: Any, *more: Any) -> Any:
        sampled.append(obj.name)
        return before(self, obj, *more)

    monkeypatch.setattr(Sampler, "sample", noted)
    street.frame_set(5)
    lines(street)
    assert sampled == []
    driving(street).location.y = 1.0
    lines(street)
    assert sampled == [driving(street).name]


def test_keys_tell_what_stepping_through_the_frames_does(street: Any) -> None:
    """Random keys, curves, rotation modes and parents: the quick sampler and Blender's own evaluation agree."""
    draw = random.Random(3)
    for one in list(imported_objects(street, "ACTOR", "EGO", "CAMERA")):
        for frame in (0, 6, 13, 19):
            one.location = [v + draw.uniform(-1, 1) for v in one.location]
            one.keyframe_insert("location", frame=frame)
            if one.rotation_mode != "QUATERNION":
                one.rotation_euler = [draw.uniform(-1, 1) for _ in range(3)]
                one.keyframe_insert("rotation_euler", frame=frame)
            else:
                one.rotation_quaternion = [draw.uniform(-1, 1) for _ in range(4)]
                one.keyframe_insert("rotation_quaternion", frame=frame)
    loose = standing(street)
    loose.animation_data_clear()
    loose.rotation_mode, loose.parent = "XYZ", next(imported_objects(street, "EGO"))
    loose.rotation_euler = (0.1, 0.2, 0.3)
    street.frame_set(4)
    clock = Clock.of(source_of(street).drive)
    slow = {one.name: one for one in sample_all(street, clock).objects}
    sampler = Sampler(street, clock, shown_names(bpy.context.view_layer.layer_collection), True)
    for one in imported_objects(street, "ACTOR", "EGO", "CAMERA", "LIDAR"):
        quick = sampler.sample(one)
        assert np.abs(quick.poses - slow[one.name].poses).max() < 2e-5, one.name
        assert (quick.there == slow[one.name].there).all(), one.name


def test_a_change_without_a_key_is_listed_before_the_frame_is_left(street: Any) -> None:
    one = driving(street)
    one.keyframe_insert("location", frame=0)
    one.keyframe_insert("location", frame=19)
    street.frame_set(9)
    assert lines(street) == ()
    one.location.y = 2.0
    (line,) = lines(street)
    assert line.what == "Moved 2.0 m left"


def test_words_of_a_slower_drive(street: Any) -> None:
    select(driving(street))
    street.frame_set(0)
    bpy.ops.unisim.retime_actor(mode="SPEED", speed=0.5)
    (line,) = lines(street)
    assert line.what.startswith("Retimed: up to"), line.what


def read_all() -> int:
    """Let the timer read until all is read; how often it was called."""
    for calls in range(1, 400):
        edit_watch._changed_s = 0.0
        if edit_watch._read() is None:
            return calls
    raise AssertionError("the reading does not end")


def test_the_timer_reads_in_steps_until_all_is_true(street: Any) -> None:
    driving(street).location.y = 1.0
    update()
    assert not reading_of(street).fresh
    read_all()
    assert reading_of(street).fresh and len(reading_of(street).lines) == 1
    assert edit_watch._read() is None


def test_the_timer_waits_for_a_quiet_moment(street: Any) -> None:
    driving(street).location.y = 1.0
    update()
    edit_watch._changed_s = time.monotonic()
    assert edit_watch._read() == edit_watch.WAIT_S and not reading_of(street).fresh


def test_a_scene_beside_does_not_have_the_list_read_for_ever(street: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    CASES["constrained"][0](street)
    update()
    evaluated: list[int] = []

    def counted(*given: Any) -> Any:
        evaluated.append(1)
        return adjacent_frames.evaluate_beside(*given)

    monkeypatch.setattr(from_keys, "evaluate_beside", counted)
    read_all()
    assert len(evaluated) == -(-20 // from_keys.FRAMES_AT_ONCE)
    for _ in range(3):  # what Blender tells of the scene beside
        edit_watch.note_changes(street, None)
        update()
        read_all()
    assert len(evaluated) == -(-20 // from_keys.FRAMES_AT_ONCE)
    edit_watch._beside_s = 0.0
    standing(street).constraints[0].target.location.z = 3.0
    update()
    read_all()
    assert len(evaluated) == 2 * -(-20 // from_keys.FRAMES_AT_ONCE)


def test_what_fails_is_said_and_ends_the_reading(street: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: Any) -> Any:
        raise KeyError("odd")

    monkeypatch.setattr(edit_list, "group_lines", broken)
    reading_of(street).mark()
    reading_of(street).known.clear()
    read_all()
    assert reading_of(street).problem == "The edits cannot be read: 'odd'" and reading_of(street).fresh
    monkeypatch.undo()
    assert lines(street) == ()


def test_an_object_deleted_while_the_list_is_read(street: Any) -> None:
    driving(street).location.y = 1.0
    update()
    steps = read_steps(street)
    next(steps)
    bpy.data.objects.remove(standing(street))
    edit_watch._at[:] = [(street.name, steps)]
    read_all()
    assert {line.part for line in reading_of(street).lines} == {"MOVE", "REMOVE"}


def drawn_rows(line: EditLine, beside: float, below: float) -> list[tuple[str, str]]:
    """What an edit's rows show: kind of the row's first element and its text."""
    rows: list[tuple[str, str]] = []

    class Layout:
        """Notes texts in place of drawing them."""

        def box(self) -> Any:
            return self

        row = column = lambda self, align=False: self

        def label(self, text: str, icon: str, translate: bool) -> None:
            rows.append(("label", text))

        def operator(self, name: str, text: str, icon: str, emboss: bool, translate: bool = True) -> Any:
            rows.extend([("button", text)] if text else [])
            return self

    draw_line(Layout(), line, lambda text, buttons=0.0: wrapped(text, beside if buttons else below, below, len))
    return rows


LONG = "Camera: 12.0 m forward, 3.0 m left, 1.5 m up, turned by 20°; another lens"
SENSOR = "front_left_camera_of_the_second_vehicle_in_the_garage"


def test_a_line_that_is_too_long_goes_on_in_the_next_row() -> None:
    line = EditLine("CAMERA", SENSOR, "SENSOR", LONG, SENSOR, SENSOR, 0.0, 1.9, (0, 19))
    (kind, first), *rest = drawn_rows(line, 24.0, 30.0)
    assert kind == "button" and len(first) <= 24 and all(kind == "label" and len(text) <= 30 for kind, text in rest)
    texts = [text for _, text in rest]
    whose = next(i for i, text in enumerate(texts) if text.startswith("front_left"))
    assert " ".join([first, *texts[:whose]]) == LONG
    assert "".join(texts[whose:]).replace(" ", "") == f"{SENSOR}, 0.0 to 1.9 s".replace(" ", "")
    assert drawn_rows(line, 200.0, 200.0) == [
        ("button", LONG),
        ("label", f"{SENSOR}, 0.0 to 1.9 s"),
    ]


def test_what_cannot_be_read_is_told_whole() -> None:
    line = EditLine("", "", "PROBLEM", LONG, SENSOR, "", 0.0, 0.0, (0,))
    text = "".join(text for _, text in drawn_rows(line, 20.0, 22.0))
    assert text.replace(" ", "") == f"{LONG}{SENSOR}".replace(" ", "")
