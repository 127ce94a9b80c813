"""Maneuvers in Blender: pressed, read as the scenario's edits, changed, copied, muted, and imported again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import edited, imported, read, select
from small_log import small_drive, write_small_log
from winding_drive import winding_drive

from unisim_blender.bridge.changes.muting import mute, unmute
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.sampling.edit_list import read_now
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.scenario import plain, save_scenario
from unisim_blender.core.scenario.motion.maneuvers import Maneuver
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import near, same
from unisim_blender.editing.simulation.sweeps import fields_of
from unisim_blender.features.motion.maneuvers import HANDLES, maneuver_handles


@pytest.fixture(scope="module")
def winding_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("winding") / "log"
    small, drive = small_drive(), winding_drive()
    camera, lidar = small.cameras["front_camera"], small.lidars["pandar64"]
    ego = drive.world_from_ego
    write_small_log(
        path,
        replace(
            drive,
            cameras={"front_camera": replace(camera, world_from_camera=ego, time_s=drive.time_s)},
            lidars={"pandar64": replace(lidar, world_from_lidar=ego, time_s=drive.time_s)},
        ),
    )
    return path


@pytest.fixture
def winding(scene: Any, winding_log: Path) -> Any:
    """The winding road, imported, at 2 s."""
    assert bpy.ops.unisim.import_log(filepath=str(winding_log)) == {"FINISHED"}
    scene.frame_set(20)
    return scene


def actor(scene: Any, name: str) -> Any:
    """The object of an actor, selected."""
    uid = next(uid for uid in source_of(scene).drive.actors if uid == name)
    select(obj := imported(scene, "ACTOR", uid))
    return obj


def press(kind: str, **numbers: Any) -> Any:
    assert bpy.ops.unisim.maneuver(kind=kind, **numbers) == {"FINISHED"}
    bpy.context.view_layer.update()
    return bpy.context.active_object


def maneuvers(scene: Any) -> list[Any]:
    return [plain(edit) for edit in read(scene).edits if isinstance(edit, Maneuver)]


def assert_shown(scene: Any, agree: Any = same) -> None:
    """Objects go where the scenario's actors go."""
    drive, clock = edited(scene), Clock.of(source_of(scene).drive)
    by_id = {obj.uid if obj.is_original else obj.title: obj for obj in sample_all(scene, clock).of("ACTOR")}
    for uid, known in drive.actors.items():
        poses = known.world_from_actor.at(clock.times_s)
        assert agree(poses, by_id[uid].poses)[by_id[uid].there].all(), uid


def warnings(scene: Any) -> list[str]:
    drive = source_of(scene).drive
    found = warnings_of(sample_all(scene, Clock.of(drive)), drive)
    return [f"{f.name} {f.text}" for f in found if f.name != "front_camera"]


PRESSED = {
    "CUT_IN": ("near", {"type": "cut_in", "gap_s": 1.5}, "Cuts in at 2.0 s, 1.5 s ahead"),
    "LANE_CHANGE": ("ahead", {"type": "lane_change", "left_m": 3.5}, "3.5 m to the left from 2.0 s"),
    "BRAKE": ("right", {"type": "brake", "deceleration_m_s2": 2.0, "speed_m_s": 0.0}, "Brakes at 2.0 m/s² from 2.0 s"),
    "CROSS": (
        "walker",
        {"type": "cross", "side": "right", "speed_m_s": 1.4, "gap_s": 1.2, "from_m": 6.0},
        "Crosses at 5.0 s, 1.2 s ahead",
    ),
}


STANDS = "goes 0 km/h and was recorded at 4 km/h to 5 km/h: its pose is extrapolated"
"""What is listed of a walker who waits before crossing."""


@pytest.mark.parametrize("kind", PRESSED)
def test_a_pressed_maneuver_is_the_scenarios_edit(winding: Any, kind: str) -> None:
    uid, edit, words = PRESSED[kind]
    obj = actor(winding, uid)
    press(kind)
    (read_edit,) = maneuvers(winding)
    assert read_edit.pop("at_s") == pytest.approx(5.0 if kind == "CROSS" else 2.0)
    assert read_edit == {**edit, "actor": uid}
    assert [line.what for line in read_now(winding)] == [words]
    assert warnings(winding) == ([f"{obj.name} {STANDS}"] if kind == "CROSS" else [])
    assert_shown(winding)
    # an ordinary edit afterwards: moved by hand, it is a move
    obj.location.y += 0.5
    bpy.context.view_layer.update()
    assert maneuvers(winding) == [] and [edit.type for edit in read(winding).edits] == ["move"]
    assert "Moved" in read_now(winding)[0].what or "New trajectory" in read_now(winding)[0].what
    obj.location.y -= 0.5
    bpy.context.view_layer.update()
    assert len(maneuvers(winding)) == 1


def test_maneuvers_come_one_after_the_other_and_after_a_shift(winding: Any) -> None:
    actor(winding, "right")
    assert bpy.ops.unisim.shift_actor(left_m=0.0, later_s=0.5, ahead_m=0.0) == {"FINISHED"}
    press("LANE_CHANGE", left_m=-2.0)
    press("BRAKE", first_s=7.0, deceleration_m_s2=3.0)
    move, *both = [plain(edit) for edit in read(winding).edits]
    assert (move["type"], move["later_s"]) == ("move", 0.5)
    assert [edit["type"] for edit in both] == ["lane_change", "brake"]
    (line,) = read_now(winding)
    assert line.what == "2.0 m to the right from 2.0 s; brakes at 3.0 m/s² from 7.0 s"
    assert_shown(winding, near)


@pytest.mark.parametrize("kind", ["CUT_IN", "CROSS"])
def test_a_new_actor_does_it_where_none_is_selected(winding: Any, kind: str) -> None:
    select()
    bpy.context.view_layer.objects.active = None
    new = press(kind)
    insert, maneuver = [plain(edit) for edit in read(winding).edits]
    assert insert["type"] == "insert" and insert["id"] == maneuver["actor"] == new.name
    assert maneuver["type"] == kind.lower()
    assert warnings(winding) == ([f"{new.name} {STANDS}"] if kind == "CROSS" else [])
    assert_shown(winding)
    (line,) = read_now(winding)
    assert line.what.startswith("Inserted; c") and line.part == "INSERT"


def test_numbers_that_are_given_stay(winding: Any) -> None:
    actor(winding, "near")
    press("CUT_IN", side="RIGHT", gap_by="LENGTH", gap_m=12.0, timed=True, duration_s=3.0, first_s=4.0)
    (edit,) = maneuvers(winding)
    expected = {"type": "cut_in", "actor": "near", "side": "right", "gap_m": 12.0, "duration_s": 3.0}
    assert edit.pop("at_s") == pytest.approx(4.0) and edit == expected


def test_a_maneuver_is_before_the_ego_as_it_is_shifted(winding: Any) -> None:
    assert bpy.ops.unisim.shift_ego(left_m=-1.5) == {"FINISHED"}
    actor(winding, "walker")
    press("CROSS")
    kinds = [edit.type for edit in read(winding).edits]
    assert kinds == ["ego", "cross"]
    assert_shown(winding)
    # the ego alone is moved on: the actor stays where it is shown to go
    assert bpy.ops.unisim.shift_ego(left_m=1.0) == {"FINISHED"}
    assert [edit.type for edit in read(winding).edits] == ["move", "ego"]
    assert_shown(winding)


def test_a_platoon_follows_its_leader_after_that_was_edited(winding: Any) -> None:
    leader = actor(winding, "ahead")
    press("BRAKE", deceleration_m_s2=1.5)
    select(leader)
    press("PLATOON", count=2, gap_s=1.0, gap_m=3.0)
    edits = [plain(edit) for edit in read(winding).edits]
    assert [edit["type"] for edit in edits] == ["duplicate", "duplicate", "brake", "follow", "follow"]
    assert [edit["leader"] for edit in edits[3:]] == ["ahead", edits[3]["actor"]]
    assert all((edit["gap_s"], edit["gap_m"]) == (1.0, 3.0) for edit in edits[3:])
    assert_shown(winding)
    assert {line.what for line in read_now(winding) if line.part == "COPY"} == {
        f"Copied; follows {edit['leader']}, 1.0 s and 3.0 m behind" for edit in edits[3:]
    }
    assert warnings(winding) == []


def test_maneuvers_come_back_from_a_scenarios_file(winding: Any, tmp_path: Path) -> None:
    actor(winding, "near")
    press("CUT_IN")
    actor(winding, "walker")
    press("CROSS")
    select(leader := imported(winding, "ACTOR", "ahead"))
    assert leader.name
    press("PLATOON", count=2)
    before = read(winding)
    save_scenario(replace(before, path=tmp_path / "s.json", log=str(source_of(winding).log_path)), tmp_path / "s.json")
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.ops.unisim.import_scenario(filepath=str(tmp_path / "s.json")) == {"FINISHED"}
    assert [plain(edit) for edit in read(bpy.context.scene).edits] == [plain(edit) for edit in before.edits]


def test_a_muted_maneuver_comes_back(winding: Any) -> None:
    actor(winding, "near")
    press("LANE_CHANGE")
    before, source = maneuvers(winding), source_of(winding)
    (line,) = read_now(winding)
    mute(winding, source, line)
    assert read(winding).edits == ()
    (line,) = read_now(winding)
    unmute(winding, source, line.muted)
    assert maneuvers(winding) == before


def test_each_number_is_a_field_of_a_batch(winding: Any) -> None:
    actor(winding, "near")
    press("CUT_IN", side="LEFT", timed=True)
    actor(winding, "walker")
    press("CROSS")
    from unisim_blender.core.scenario import scenario_to_json

    labels = {field.label for field in fields_of(scenario_to_json(read(winding)), {"near": "Car 1", "walker": "Man"})}
    assert labels >= {
        "Car 1: time (s)", "Car 1: gap (s)", "Car 1: duration (s)", "Car 1: side", "Man: time (s)", "Man: gap (s)",
        "Man: speed (m/s)", "Man: distance aside (m)", "Man: side",
    }  # fmt: skip


@pytest.mark.parametrize("kind", ["LANE_CHANGE", "BRAKE", "PLATOON"])
def test_what_needs_an_actor_says_so(winding: Any, kind: str) -> None:
    select()
    with pytest.raises(RuntimeError, match="Select a moving actor first"):
        bpy.ops.unisim.maneuver(kind=kind)
    assert len(list(imported_objects(winding, "ACTOR"))) == 4


def test_what_cannot_be_is_refused_in_words_of_the_window(winding: Any) -> None:
    obj = actor(winding, "near")
    winding.frame_set(90)
    with pytest.raises(RuntimeError, match=rf"The lane change of {obj.name} takes .* are left: begin earlier"):
        bpy.ops.unisim.maneuver(kind="LANE_CHANGE")
    assert read(winding).edits == () and np.isfinite(obj.location).all()


def test_a_handle_changes_its_number_as_dragging_does(winding: Any) -> None:
    obj = actor(winding, "walker")
    press("CROSS", gap_by="LENGTH", gap_m=8.0)
    clock = Clock.of(source_of(winding).drive)
    ((name, place),) = maneuver_handles(obj, clock)
    assert name == "gap_m"
    assert bpy.ops.unisim.drag_maneuver(number=name, value=11.0) == {"FINISHED"}
    (edit,) = maneuvers(winding)
    assert edit["gap_m"] == pytest.approx(11.0) and edit["side"] == "right"
    ((_, after),) = maneuver_handles(obj, clock)
    assert np.linalg.norm(after - place) == pytest.approx(3.0, abs=0.05)
    assert_shown(winding)


@pytest.mark.parametrize("kind", ["CUT_IN", "LANE_CHANGE", "BRAKE"])
def test_handles_lie_where_a_number_shows(winding: Any, kind: str) -> None:
    obj = actor(winding, PRESSED[kind][0])
    press(kind)
    clock = Clock.of(source_of(winding).drive)
    handles = maneuver_handles(obj, clock)
    assert [name for name, _ in handles] == [name for name in HANDLES[kind.lower()] if name in maneuvers(winding)[0]]
    for name, place in handles:
        before = maneuvers(winding)[0][name]
        if name != "at_s":
            assert bpy.ops.unisim.drag_maneuver(number=name, value=before - 0.2) == {"FINISHED"}
            moved = np.linalg.norm(dict(maneuver_handles(obj, clock))[name] - place)
            per_unit = {"left_m": (0.9, 1.1), "gap_s": (5.0, 15.0), "deceleration_m_s2": (0.5, 30.0)}[name]
            assert per_unit[0] < moved / 0.2 < per_unit[1]  # the handle follows the mouse
        assert bpy.ops.unisim.drag_maneuver(number=name, value=before + 0.2) == {"FINISHED"}
        assert maneuvers(winding)[0][name] == pytest.approx(before + 0.2, abs=1e-4)
    (numbers,) = maneuvers(winding)
    assert bpy.ops.unisim.drag_maneuver(number="at_s", value=99.0) == {"FINISHED"}
    assert maneuvers(winding) == [numbers]  # what cannot be leaves it as it was


def test_what_was_moved_since_has_no_maneuver_to_drag(winding: Any) -> None:
    obj = actor(winding, "near")
    press("LANE_CHANGE")
    obj.location.y += 1.0
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="The actor was moved since its maneuver"):
        bpy.ops.unisim.drag_maneuver(number="left_m", value=2.0)
