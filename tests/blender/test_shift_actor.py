"""Actors shifted sideways, by arc length along their path, and in time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import assert_alike, edited, imported, read, select

from unisim_blender.bridge.changes.motion import displaced_along
from unisim_blender.bridge.objects.animation import curves_of, write_keys
from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.objects.trajectories import trajectory_of
from unisim_blender.bridge.sampling.edit_list import read_now
from unisim_blender.core.geometry import FloatArray, invert_pose, quaternion_from_yaw
from unisim_blender.core.scenario.edits import Move


def actor(scene: Any, moving: bool) -> str:
    """The id of a car that drives, present throughout, or of one that stands."""
    drive = source_of(scene).drive
    first, last = min(drive.time_s.values()), max(drive.time_s.values())
    return next(
        uid
        for uid, one in sorted(drive.actors.items())
        if one.is_moving == moving and "Car" in one.label and one.start_s <= first and one.end_s >= last
    )


def arc(angles: FloatArray, radius_m: float) -> tuple[FloatArray, FloatArray]:
    """Positions (K, 3) and quaternions (K, 4) on a circle that turns left."""
    positions = np.stack([radius_m * np.sin(angles), radius_m * (1 - np.cos(angles)), np.zeros_like(angles)], -1)
    return positions, quaternion_from_yaw(angles)


def test_sideways_is_its_left(street: Any) -> None:
    uid = actor(street, moving=True)
    select(imported(street, "ACTOR", uid))
    assert bpy.ops.unisim.shift_actor(left_m=2.0, ahead_m=0.0, later_s=0.0) == {"FINISHED"}
    recorded, now = source_of(street).drive, edited(street)
    for time in (0.3, 1.5):
        apart = invert_pose(recorded.actors[uid].world_from_actor.at(time)) @ now.actors[uid].world_from_actor.at(time)
        assert apart[:3, 3] == pytest.approx([0.0, 2.0, 0.0], abs=1e-3)


def test_along_a_path_that_turns(street: Any) -> None:
    uid = actor(street, moving=True)
    one = imported(street, "ACTOR", uid)
    above = trajectory_of(one)
    angles = np.linspace(0, 1.0, 20)
    positions, quaternions = arc(angles, 20.0)
    write_keys(above, np.arange(20.0), positions, quaternions)
    select(one)
    assert bpy.ops.unisim.shift_actor(left_m=0.0, ahead_m=4.0, later_s=0.0) == {"FINISHED"}
    street.frame_set(8)
    expected, _ = arc(angles[8:9] + 4.0 / 20.0, 20.0)
    assert np.array(one.matrix_world.translation) == pytest.approx(expected[0], abs=0.02)
    straight = positions[8] + 4.0 * np.array([np.cos(angles[8]), np.sin(angles[8]), 0.0])
    assert np.linalg.norm(np.array(one.matrix_world.translation) - straight) > 0.3
    assert one.matrix_world.to_euler().z == pytest.approx(angles[8] + 0.2, abs=0.01)


def test_later_takes_its_presence_along(street: Any) -> None:
    uid = actor(street, moving=True)
    one, recorded = imported(street, "ACTOR", uid), source_of(street).drive.actors[actor(street, moving=True)]
    select(one)
    assert bpy.ops.unisim.shift_actor(left_m=0.0, ahead_m=0.0, later_s=0.4) == {"FINISHED"}
    now = edited(street).actors[uid]
    assert now.world_from_actor.at(1.2)[:3, 3] == pytest.approx(recorded.world_from_actor.at(0.8)[:3, 3], abs=0.01)


def test_all_at_once_is_one_edit_and_is_reported(street: Any, capfd: Any) -> None:
    uid = actor(street, moving=True)
    select(imported(street, "ACTOR", uid))
    bpy.ops.unisim.shift_actor(left_m=-1.0, ahead_m=2.0, later_s=0.2)
    (edit,) = read(street).edits
    assert isinstance(edit, Move) and edit.actor == uid
    said = capfd.readouterr().out
    assert "1.0 m to the right, 2.0 m forward along its path, 0.20 s (2.0 frames) later" in said


def test_what_stands_still_moves_along_its_axis(street: Any, capfd: Any) -> None:
    uid = actor(street, moving=False)
    one = imported(street, "ACTOR", uid)
    before = np.array(one.matrix_world, float)
    select(one)
    bpy.ops.unisim.shift_actor(left_m=1.0, ahead_m=2.0, later_s=0.5)
    apart = np.linalg.inv(before) @ np.array(one.matrix_world, float)
    assert apart[:3, 3] == pytest.approx([2.0, 1.0, 0.0], abs=1e-4)
    said = capfd.readouterr().out
    assert "2.0 m forward (it stands still)" in said and "at the same times" in said


def test_a_copy_that_is_shifted_leaves_its_source_alone(street: Any) -> None:
    uid = actor(street, moving=True)
    select(imported(street, "ACTOR", uid))
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    bpy.ops.unisim.shift_actor(left_m=0.0, ahead_m=6.0, later_s=0.0)
    street.frame_set(5)
    assert len(read(street).edits) == 1
    source = imported(street, "ACTOR", uid)
    assert (copy.matrix_world.translation - source.matrix_world.translation).length == pytest.approx(6, abs=0.1)


def test_displacing_keeps_how_keys_blend(street: Any) -> None:
    one = imported(street, "ACTOR", actor(street, moving=True))
    for frame, left in ((2, 0.0), (12, 3.0)):
        one.location = (0.0, left, 0.0)
        one.keyframe_insert("location", frame=frame)
    (curve,) = [c for c in curves_of(one) if c.data_path == "location" and c.array_index == 1]
    before = curve.evaluate(4)
    displaced_along(one, (0.0, 1.0, 0.0))
    (curve,) = [c for c in curves_of(one) if c.data_path == "location" and c.array_index == 1]
    assert curve.keyframe_points[0].interpolation == "BEZIER" and curve.evaluate(4) == pytest.approx(
        before + 1.0, abs=1e-5
    )


def test_grey_without_an_actor(street: Any) -> None:
    select()
    assert not bpy.ops.unisim.shift_actor.poll()


@pytest.mark.parametrize("left_m", [0.0, 1.25])
@pytest.mark.parametrize(("ahead_m", "later_s"), [(0.0, 0.0), (0.0, 0.6), (-2.5, 0.0), (2.0, -0.35)])
def test_the_scenario_says_what_was_shifted(
    street: Any, tmp_path: Path, left_m: float, ahead_m: float, later_s: float
) -> None:
    uid = actor(street, moving=True)
    select(imported(street, "ACTOR", uid))
    bpy.ops.unisim.shift_actor(left_m=left_m, ahead_m=ahead_m, later_s=later_s)
    scenario = read(street)
    if not left_m and not later_s and not ahead_m:
        assert scenario.edits == ()
        return
    (edit,) = scenario.edits
    assert isinstance(edit, Move) and edit.trajectory is None and edit.pose is None
    assert (edit.offset_m, edit.later_s, edit.ahead_m) == ((0.0, left_m, 0.0), later_s or None, ahead_m or None)
    path = tmp_path / "scenario.json"
    assert bpy.ops.unisim.export_scenario(filepath=str(path)) == {"FINISHED"}
    before = edited(street)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert bpy.ops.unisim.import_scenario(filepath=str(path)) == {"FINISHED"}
    assert read(bpy.context.scene).edits == (edit,)
    assert_alike(before, edited(bpy.context.scene))


def test_what_has_no_front_is_shifted_copied_and_told_as_the_ego_sees_it(street: Any) -> None:
    """Annotations turn cones as they like: left is the ego's left."""
    uid = next(uid for uid, one in sorted(source_of(street).drive.actors.items()) if "Cone" in one.label)
    one, drive = imported(street, "ACTOR", uid), source_of(street).drive
    select(one)
    assert bpy.ops.unisim.shift_actor(left_m=1.5, ahead_m=-2.0, later_s=0.0) == {"FINISHED"}
    (line,) = read_now(street)
    assert line.what == "Moved 2.0 m back, 1.5 m left"
    apart = edited(street).actors[uid].world_from_actor.positions - drive.actors[uid].world_from_actor.positions
    ego = drive.world_from_ego.at(drive.time_s[0])
    assert (ego[:3, :3].T @ apart[0])[:2] == pytest.approx([-2.0, 1.5], abs=0.1)
    assert bpy.ops.unisim.duplicate_actor(where="LANE_RIGHT", lane_m=3.0) == {"FINISHED"}
    copied = next(line for line in read_now(street) if line.part == "COPY")
    assert copied.what == "Copied: 2.0 m back, 1.5 m right"
