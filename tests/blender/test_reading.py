"""Blender's own tools are edits: the scenario is what differs from the import."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import driving, edited, imported, read, select

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.objects.trajectories import trajectory_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.scenario import load_scenario, save_scenario
from unisim_blender.core.scenario.edits import Brake, CopyStatic, Duplicate, Ego, Move, Remove, RemoveStatic
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import same


def standing(scene: Any) -> str:
    """The id of an actor that stands still."""
    return next(uid for uid, actor in sorted(source_of(scene).drive.actors.items()) if not actor.is_moving)


def agree(scene: Any) -> None:
    """The edited drive has every actor where Blender shows it."""
    drive = edited(scene)
    clock = Clock.of(source_of(scene).drive)
    for one in sample_all(scene, clock).of("ACTOR"):
        uid = one.uid if one.is_original else one.name
        if not one.there.any():
            assert uid not in drive.actors
            continue
        actor = drive.actors[uid]
        poses = actor.world_from_actor.at(clock.times_s if actor.is_moving else np.zeros(len(clock.times_s)))
        assert same(poses[one.there], one.poses[one.there]).all(), uid
        assert (actor.present(clock.times_s) == one.there).all() or (one.there == one.there[0]).all(), uid


def test_x_removes(street: Any) -> None:
    uid = driving(street).unisim.uid
    bpy.data.objects.remove(imported(street, "ACTOR", uid))
    assert read(street).edits == (Remove(uid),)


def test_hiding_for_renders_removes(street: Any) -> None:
    uid = standing(street)
    imported(street, "ACTOR", uid).hide_render = True
    assert read(street).edits == (Remove(uid),)


def test_a_collection_that_is_not_rendered_removes(street: Any) -> None:
    uid = standing(street)
    one = imported(street, "ACTOR", uid)
    away = bpy.data.collections.new("away")
    street.collection.children.link(away)
    away.objects.link(one)
    for collection in list(one.users_collection):
        if collection != away:
            collection.objects.unlink(one)
    away.hide_render = True
    assert read(street).edits == (Remove(uid),)


def test_g_moves_what_stands(street: Any) -> None:
    uid = standing(street)
    one = imported(street, "ACTOR", uid)
    one.location.x += 2.5
    (edit,) = read(street).edits
    assert isinstance(edit, Move) and edit.actor == uid and edit.pose is not None
    agree(street)


def test_keys_are_a_trajectory(street: Any) -> None:
    uid = driving(street).unisim.uid
    one = trajectory_of(imported(street, "ACTOR", uid))
    assert one is not None
    from unisim_blender.bridge.objects.animation import keys_of, write_keys

    keys = keys_of(one)
    assert keys is not None
    frames, positions, turns = keys
    late = frames > frames[len(frames) // 2]
    positions[late] += [0.0, 1.5, 0.0]
    write_keys(one, frames, positions, turns)
    (edit,) = read(street).edits
    assert isinstance(edit, Move) and edit.trajectory is not None
    agree(street)
    recorded = source_of(street).drive.actors[uid].world_from_actor
    now = edited(street).actors[uid].world_from_actor
    early = float(source_of(street).drive.time_s[0]) + 0.05
    assert np.abs(now.at(early) - recorded.at(early)).max() < 1e-6


def test_shift_d_is_a_new_actor_of_the_same_appearance(street: Any) -> None:
    uid = driving(street).unisim.uid
    select(imported(street, "ACTOR", uid))
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    copy.delta_location = (0.0, 3.5, 0.0)
    (edit,) = read(street).edits
    assert isinstance(edit, Duplicate) and edit.actor == uid and edit.id == copy.name
    assert edit.offset_m == pytest.approx((0.0, 3.5, 0.0), abs=1e-4)
    agree(street)


def test_alt_d_is_one_too(street: Any) -> None:
    uid = standing(street)
    select(imported(street, "ACTOR", uid))
    bpy.ops.object.duplicate(linked=True)
    bpy.context.active_object.location.y += 4.0
    (edit,) = read(street).edits
    assert isinstance(edit, Duplicate) and edit.actor == uid
    agree(street)


def test_a_parent_counts(street: Any) -> None:
    uid = driving(street).unisim.uid
    empty = bpy.data.objects.new("parent", None)
    street.collection.objects.link(empty)
    one = imported(street, "ACTOR", uid)
    one.parent = empty
    empty.location = (0.0, -1.0, 0.0)
    (edit,) = read(street).edits
    assert isinstance(edit, Move)
    agree(street)


def test_undo_brings_back(street: Any) -> None:
    uid = standing(street)
    bpy.ops.ed.undo_push(message="before")
    select(imported(street, "ACTOR", uid))
    bpy.ops.unisim.delete_actor()
    bpy.ops.ed.undo_push(message="after")
    assert read(bpy.context.scene).edits == (Remove(uid),)
    bpy.ops.ed.undo()
    assert read(bpy.context.scene).edits == ()
    bpy.ops.ed.redo()
    assert read(bpy.context.scene).edits == (Remove(uid),)


def test_next_lane(street: Any) -> None:
    uid = driving(street).unisim.uid
    select(imported(street, "ACTOR", uid))
    assert bpy.ops.unisim.duplicate_actor(where="LANE_LEFT") == {"FINISHED"}
    (edit,) = read(street).edits
    assert isinstance(edit, Duplicate) and edit.actor == uid
    agree(street)
    clock = Clock.of(source_of(street).drive)
    source, copy = edited(street).actors[uid], edited(street).actors[edit.id]
    apart = np.linalg.norm(
        copy.world_from_actor.at(clock.times_s) - source.world_from_actor.at(clock.times_s), axis=(1, 2)
    )
    assert np.abs(apart - 3.5).max() < 1e-3


@pytest.mark.parametrize("mode", ["DELAY", "SPEED", "STOP", "STRETCH"])
def test_retimed_actors_stay_on_their_path(street: Any, mode: str) -> None:
    uid = driving(street).unisim.uid
    one = imported(street, "ACTOR", uid)
    select(one)
    street.frame_set(8)
    last = {"last_s": 1.2} if mode == "STRETCH" else {}
    assert bpy.ops.unisim.retime_actor(mode=mode, seconds=0.4, speed=0.5, first_s=0.4, **last) == {"FINISHED"}
    (edit,) = read(street).edits
    assert isinstance(edit, Brake if mode == "STOP" else Move)
    agree(street)
    drive = source_of(street).drive
    fine = np.linspace(0, drive.duration_s, 400)
    path = drive.actors[uid].world_from_actor.at(fine)[:, :3, 3]
    clock = Clock.of(drive)
    there = [o for o in sample_all(street, clock).of("ACTOR") if o.uid == uid][0]
    inside = there.poses[1:, :3, 3]
    nearest = np.linalg.norm(inside[:, None] - path[None], axis=-1).min(1)
    assert np.median(nearest) < 0.1


def test_ego_shift(street: Any) -> None:
    bpy.ops.unisim.shift_ego(left_m=1.0)
    scenario = read(street)
    (edit,) = scenario.edits
    assert isinstance(edit, Ego) and edit.shift_left_m == pytest.approx(1.0, abs=1e-5)
    assert scenario.sensors is None


def test_static_items(street: Any) -> None:
    street.cursor.location = (20.0, 4.0, 0.0)
    select()
    assert bpy.ops.unisim.mark_static() == {"FINISHED"}
    assert read(street).edits == ()
    street.cursor.location = (26.0, 4.5, 0.0)
    bpy.ops.unisim.copy_static()
    (edit,) = read(street).edits
    assert isinstance(edit, CopyStatic) and edit.target.position[:2] == pytest.approx((26.0, 4.5), abs=1e-4)
    select(imported(street, "STATIC", "item-1"))
    bpy.ops.unisim.delete_actor()
    removed, copied = read(street).edits
    assert removed == RemoveStatic("item-1") and isinstance(copied, CopyStatic)
    select(*[o for o in street.objects if o.unisim.kind == "STATIC"])
    bpy.ops.unisim.forget_static()
    assert read(street).edits == () and read(street).boxes is None


def test_the_scenario_survives_its_file(street: Any, tmp_path: Path) -> None:
    select(driving(street))
    bpy.ops.unisim.duplicate_actor(where="RIGHT")
    bpy.ops.unisim.shift_ego(left_m=-0.5)
    path = tmp_path / "scenario.json"
    assert bpy.ops.unisim.export_scenario(filepath=str(path)) == {"FINISHED"}
    scenario = load_scenario(path)
    save_scenario(scenario, tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


def test_a_moved_camera(street: Any) -> None:
    camera = street.camera
    camera.location.z += 0.5
    sensors = read(street).sensors
    assert sensors is not None and sensors.cameras is not None and sensors.lidars is None
    (spec,) = [s for s in sensors.cameras if s.id == camera.unisim.uid]
    assert spec.mount_offset is not None and spec.mount_offset.position == pytest.approx((0.0, 0.0, 0.5), abs=2e-4)


def test_a_deleted_sensor_is_not_rendered(street: Any) -> None:
    bpy.data.objects.remove(next(o for o in street.objects if o.unisim.kind == "LIDAR"))
    sensors = read(street).sensors
    assert sensors is not None and sensors.lidars == ()
