"""Moving what drives: the whole trajectory is displaced, and keyed changes blend."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import driving, edited, imported, read, select
from mathutils import Quaternion, Vector

from unisim_blender.bridge.changes import following
from unisim_blender.bridge.changes.motion import displaced_along
from unisim_blender.bridge.objects.animation import keys_of, write_keys
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.trajectories import convert, remove, trajectory_of
from unisim_blender.core.geometry import invert_pose
from unisim_blender.core.scenario.edits import Duplicate, Ego, Move
from unisim_blender.editing.motion.keys import BLEND_S


def let_go() -> list[str]:
    """What happens when a person lets go of what is dragged."""
    bpy.context.view_layer.update()
    following.note_changes(bpy.context.scene, bpy.context.evaluated_depsgraph_get())
    for one in bpy.context.selected_objects:
        following._unsettled.add((bpy.context.scene.name, one.name))
        following._changed.setdefault(bpy.context.scene.name, set()).add(one.name)
    return following.settle_now()


def drag(one: Any, offset: tuple[float, float, float], keyed: bool = False) -> list[str]:
    """G by an offset in the world, as Blender's own operator makes it of a selected object."""
    select(one)
    one.matrix_world.translation = one.matrix_world.translation + Vector(offset)
    if keyed:
        one.keyframe_insert("location", frame=bpy.context.scene.frame_current)
    return let_go()


def displacement(scene: Any, uid: str) -> Any:
    """Displacements (N, 3) of an edited actor in its recorded axes, at the drive's frames."""
    recorded = source_of(scene).drive
    times = np.array(sorted(recorded.time_s.values()))
    base, now = (drive.actors[uid].world_from_actor.at(times) for drive in (recorded, edited(scene)))
    return (invert_pose(base) @ now)[:, :3, 3]


def test_g_displaces_the_whole_trajectory(street: Any) -> None:
    uid = driving(street).unisim.uid
    one = imported(street, "ACTOR", uid)
    street.frame_set(8)
    (said,) = drag(one, (0.0, 3.0, 0.0))
    assert "whole trajectory" in said
    expected = np.array(one.location)
    assert np.linalg.norm(expected) == pytest.approx(3.0, abs=1e-4)
    street.frame_set(9)
    assert np.array(one.location) == pytest.approx(expected, abs=1e-6)
    (edit,) = read(street).edits
    assert isinstance(edit, Move) and edit.actor == uid
    assert displacement(street, uid) == pytest.approx(
        np.tile(expected, (len(source_of(street).drive.time_s), 1)), abs=2e-3
    )


def test_r_turns_it_at_every_frame(street: Any) -> None:
    uid = driving(street).unisim.uid
    one = imported(street, "ACTOR", uid)
    select(one)
    one.rotation_quaternion = Quaternion((0.0, 0.0, 1.0), 0.4)
    let_go()
    street.frame_set(12)
    recorded, now = source_of(street).drive.actors[uid], edited(street).actors[uid]
    for time in (0.3, 1.0):
        turn = invert_pose(recorded.world_from_actor.at(time)) @ now.world_from_actor.at(time)
        assert np.arctan2(turn[1, 0], turn[0, 0]) == pytest.approx(0.4, abs=1e-4)


def test_the_vehicle_too(street: Any) -> None:
    ego = next(imported_objects(street, "EGO"))
    select(ego)
    ego.location.y += 1.5
    assert "whole trajectory" in let_go()[0]
    street.frame_set(3)
    (edit,) = read(street).edits
    assert isinstance(edit, Ego) and edit.shift_left_m == pytest.approx(1.5, abs=1e-4)


def test_with_auto_key_a_change_blends_in(street: Any) -> None:
    uid = driving(street).unisim.uid
    one = imported(street, "ACTOR", uid)
    street.frame_set(10)
    street.tool_settings.use_keyframe_insert_auto = True
    (said,) = drag(one, (0.0, 1.0, 0.0), keyed=True)
    assert "keyed at frame 10" in said
    street.tool_settings.use_keyframe_insert_auto = False
    apart = np.linalg.norm(displacement(street, uid), axis=1)
    frames = sorted(source_of(street).drive.time_s)
    assert apart[frames.index(10)] == pytest.approx(1.0, abs=1e-3)
    assert np.abs(np.diff(apart)).max() < 0.15, "it jumps"
    rate = street.render.fps / street.render.fps_base
    assert len(frames) < 2 * BLEND_S * rate + 2
    curve = next(
        c for c in one.animation_data.action.layers[0].strips[0].channelbags[0].fcurves if c.data_path == "location"
    )
    assert [key.co[0] for key in curve.keyframe_points] == pytest.approx([10 - BLEND_S * rate, 10, 10 + BLEND_S * rate])
    assert following.settle_now() == []
    before = [tuple(key.co) for key in curve.keyframe_points]
    let_go()
    assert [tuple(key.co) for key in curve.keyframe_points] == before


def test_auto_key_of_what_is_animated_alone_keys_what_drives(street: Any) -> None:
    """As Blender 5.2 has it at first: it adds keys to what has keys, and those of a car that drives
    are its parent's."""
    one, edit = driving(street), bpy.context.preferences.edit
    uid, before, edit.use_keyframe_insert_available = one.unisim.uid, edit.use_keyframe_insert_available, True
    try:
        street.frame_set(10)
        street.tool_settings.use_keyframe_insert_auto = True
        (said,) = drag(one, (0.0, 1.0, 0.0))
        assert "keyed at frame 10" in said
        apart = np.linalg.norm(displacement(street, uid), axis=1)
        assert apart.max() == pytest.approx(1.0, abs=1e-3) and apart[0] < 0.5
    finally:
        edit.use_keyframe_insert_available = before
        street.tool_settings.use_keyframe_insert_auto = False


def test_operators_displace_the_whole_with_auto_key_too(street: Any) -> None:
    one, edit = driving(street), bpy.context.preferences.edit
    before, edit.use_keyframe_insert_available = edit.use_keyframe_insert_available, True
    try:
        street.tool_settings.use_keyframe_insert_auto = True
        select(one)
        displaced_along(one, (0.0, 2.0, 0.0))
        let_go()
        assert np.ptp(np.linalg.norm(displacement(street, one.unisim.uid), axis=1)) < 1e-3, "it is keyed"
    finally:
        edit.use_keyframe_insert_available = before
        street.tool_settings.use_keyframe_insert_auto = False


def test_auto_key_starts_from_the_displacement_before(street: Any) -> None:
    uid = driving(street).unisim.uid
    one = imported(street, "ACTOR", uid)
    drag(one, (0.0, 2.0, 0.0))
    before = np.array(one.location)
    street.tool_settings.use_keyframe_insert_auto = True
    street.frame_set(10)
    drag(one, (0.0, 1.0, 0.0), keyed=True)
    street.tool_settings.use_keyframe_insert_auto = False
    curves = one.animation_data.action.layers[0].strips[0].channelbags[0].fcurves
    ends = [c.keyframe_points[0].co[1] for c in curves if c.data_path == "location"]
    assert ends == pytest.approx(before, abs=1e-5)


def test_a_change_without_a_key_is_kept_at_the_next_frame(street: Any) -> None:
    one = driving(street)
    street.frame_set(5)
    for frame, left in ((0, 0.0), (19, 1.0)):
        one.location.y = left
        one.keyframe_insert("location", frame=frame)
    street.frame_set(5)
    at_5 = float(one.location.y)
    one.location.y += 2.0
    select(one)
    let_go()
    street.frame_set(6)
    street.frame_set(5)
    assert one.location.y == pytest.approx(at_5 + 2.0, abs=1e-4)
    street.frame_set(19)
    assert one.location.y == pytest.approx(3.0, abs=1e-4)


def test_undo_and_a_saved_file_keep_it(street: Any, tmp_path: Path) -> None:
    uid = driving(street).unisim.uid
    drag(imported(street, "ACTOR", uid), (0.0, 3.0, 0.0))
    before = read(street)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "drive.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "drive.blend"))
    assert read(bpy.context.scene).edits == before.edits


def test_a_copy_rides_on_the_same_trajectory_until_it_is_retimed(street: Any) -> None:
    uid = driving(street).unisim.uid
    one = imported(street, "ACTOR", uid)
    select(one)
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    assert trajectory_of(copy) == trajectory_of(one)
    copy.location.y = 3.5
    (edit,) = read(street).edits
    assert isinstance(edit, Duplicate) and edit.offset_m == pytest.approx((0.0, 3.5, 0.0), abs=1e-4)
    from unisim_blender.bridge.changes.motion import retimed

    retimed(copy, lambda frames: frames + 3)
    assert trajectory_of(copy) != trajectory_of(one)
    (edit,) = read(street).edits
    assert isinstance(edit, Duplicate) and edit.actor == uid and edit.trajectory is not None


def test_what_nothing_rides_on_is_deleted(street: Any) -> None:
    one = driving(street)
    above = trajectory_of(one)
    assert above is not None
    name = above.name
    remove(one)
    assert name not in bpy.data.objects and name not in bpy.data.actions


def test_files_of_earlier_versions_are_brought_up_to_date(street: Any) -> None:
    uid = driving(street).unisim.uid
    one, ego = imported(street, "ACTOR", uid), next(imported_objects(street, "EGO"))
    for old in (one, ego):  # as it was: keys on the object itself
        above = trajectory_of(old)
        assert above is not None
        keys, old.parent = keys_of(above), above.parent
        assert keys is not None
        bpy.data.objects.remove(above)
        write_keys(old, *keys)
    street.unisim.trajectories = False
    assert not read(street).edits
    following.look_again()
    assert trajectory_of(one) is not None and trajectory_of(ego) is not None and not keys_of(one)
    assert not read(street).edits and read(street).sensors is None
    assert not convert(one)


def test_a_trajectory_is_neither_seen_nor_picked(street: Any) -> None:
    for one in imported_objects(street, "TRAJECTORY"):
        assert one.hide_select and one.hide_viewport and all(one.lock_location)


def test_what_stands_still_does_not_slide(street: Any) -> None:
    one = driving(street)
    for frame, left in ((2, 0.0), (12, 3.0)):
        one.location = (0.0, left, 0.0)
        one.keyframe_insert("location", frame=frame)
    select(one)
    assert bpy.ops.unisim.retime_actor(
        mode="STOP", first_s=0.4, seconds=0.8, braking="CUSTOM", deceleration_m_s2=40.0
    ) == {"FINISHED"}
    places = []
    for frame in (13, 14, 15):
        street.frame_set(frame)
        places.append(np.array(one.matrix_world.translation))
    assert np.ptp(places, axis=0).max() < 0.02
