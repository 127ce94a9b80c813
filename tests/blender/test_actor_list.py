"""The actor list: who is in it, what it says, filters and order, and that it survives what people do."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import SAMPLE, calls, driving_car, imported, read, select

from unisim_blender.bridge.objects.animation import curves_of, keys_of, write_keys
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.trajectories import keyed_pose, keyed_poses, trajectory_of
from unisim_blender.bridge.views import actors
from unisim_blender.bridge.views.actors import card_of
from unisim_blender.bridge.views.trails import compared_now
from unisim_blender.editing.actors.table import Entry, speed_text
from unisim_blender.editing.layout.speed_graph import values
from unisim_blender.editing.motion.kinematics import Limits
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.texts import kmh
from unisim_blender.features.actor_list import listing
from unisim_blender.features.actor_list.operators import GROUPS, ORDERS, turn_to
from unisim_blender.features.actor_list.panel import UNISIM_UL_actors


def entries(scene: Any) -> dict[str, Entry]:
    """What the list knows, by the objects' names."""
    return {entry.name: entry for entry in listing.refresh_now(scene).entries.values()}


def shown(scene: Any) -> list[str]:
    """The names that the list shows, in order."""
    return [entry.name for entry in listing.refresh_now(scene).shown]


def rows_of(scene: Any) -> tuple[list[int], list[int]]:
    """Which of the scene's objects the list shows, and at which places."""
    rows: Any = SimpleNamespace(bitflag_filter_item=1 << 30)
    filter_items: Any = UNISIM_UL_actors.filter_items
    found: tuple[list[int], list[int]] = filter_items(rows, bpy.context, scene, "objects")
    return found


def test_it_says_what_the_card_says(street: Any) -> None:
    drive = source_of(street).drive
    for frame in (0, 7, 19):
        street.frame_set(frame)
        known = entries(street)
        assert len(known) == len(drive.actors)
        for one in imported_objects(street, "ACTOR"):
            said, row = actors.card_of(street, one, drive), known[one.name]
            assert row.speed_m_s == pytest.approx(said.speed_m_s, abs=1e-3) and row.label == said.label
            assert row.distance_m == pytest.approx(said.distance_m, abs=1e-3) and row.present_s == pytest.approx(
                said.present_s
            )
            assert row.there == (not one.hide_viewport) and not row.edited


def evaluated_pose(scene: Any, obj: Any, frame: float) -> Any:
    scene.frame_set(int(frame), subframe=frame - int(frame))
    return np.array(obj.matrix_world)


def test_keys_tell_poses_of_all_frames_as_blender_evaluates_them(street: Any) -> None:
    one = next(o for o in imported_objects(street, "ACTOR") if o.parent is not None)
    one.location = (0.5, -1.0, 0.0)
    frames = np.array([0.0, 3.0, 3.5, 19.0])
    for mode in ("QUATERNION", "XYZ", "AXIS_ANGLE"):
        one.rotation_mode = mode
        one.rotation_euler, one.rotation_axis_angle = (0.0, 0.0, 0.3), (0.4, 0.0, 0.0, 1.0)
        known = keyed_poses(one, frames)
        assert np.allclose(known, [evaluated_pose(street, one, frame) for frame in frames], atol=1e-4)
        assert np.allclose(keyed_pose(one, 3.5), known[2])


def test_only_what_the_scenario_names_is_edited(street: Any) -> None:
    cars = [o for o in imported_objects(street, "ACTOR") if o.unisim.uid.startswith("car")]
    standing = [o for o in cars if o.parent is None]
    driving = [o for o in cars if o.parent is not None]
    standing[0].location.x += 1.0
    standing[1].hide_render = True
    select(driving[0])
    bpy.ops.unisim.retime_actor(mode="DELAY", seconds=0.3)
    select(standing[2])
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object.name
    select(driving[1])
    bpy.ops.unisim.replace_appearance(appearance=standing[3].unisim.uid)
    listing.look_again()
    edited = {name for name, row in entries(street).items() if row.edited}
    assert edited == {standing[0].name, standing[1].name, driving[0].name, copy, driving[1].name}
    assert len(read(street).edits) == 5
    assert not entries(street)[standing[1].name].there  # removed


def test_it_survives_rename_undo_deletion_and_reload(street: Any, tmp_path: Path) -> None:
    bpy.ops.ed.undo_push(message="imported")
    first = imported(street, "ACTOR", "car-04")
    first.name = "Mine"
    assert "Mine" in entries(street) and not entries(street)["Mine"].edited
    bpy.ops.ed.undo_push(message="renamed")
    select(bpy.data.objects["Mine"])
    bpy.ops.unisim.delete_actor()
    bpy.ops.ed.undo_push(message="deleted")
    scene = bpy.context.scene
    assert "Mine" not in entries(scene) and len(entries(scene)) == 19
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert "Mine" in entries(scene) and len(entries(scene)) == 20
    bpy.ops.ed.undo()
    scene = bpy.context.scene
    assert "Mine" not in entries(scene) and len(entries(scene)) == 20
    path = tmp_path / "drive.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(path))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    assert not entries(bpy.context.scene)
    bpy.ops.wm.open_mainfile(filepath=str(path))
    assert len(entries(bpy.context.scene)) == 20


def test_a_copy_stands_for_a_deleted_original(street: Any) -> None:
    own = imported(street, "ACTOR", "car-04")
    select(own)
    bpy.ops.object.duplicate()
    copy = bpy.context.active_object
    assert entries(street)[copy.name].edited
    bpy.data.objects.remove(own)
    bpy.context.view_layer.update()
    assert not entries(street)[copy.name].edited and not read(street).edits


def test_another_state_of_the_file_is_read_anew(street: Any) -> None:
    one = next(o for o in imported_objects(street, "ACTOR") if o.parent is not None)
    before = entries(street)[one.name].distance_m
    for curve in curves_of(one.parent):  # writing keys so tells the depsgraph nothing
        if curve.data_path == "location" and curve.array_index == 0:
            points = np.empty(2 * len(curve.keyframe_points), np.float32)
            curve.keyframe_points.foreach_get("co", points)
            points[1::2] += 40.0
            curve.keyframe_points.foreach_set("co", points)
    listing.look_again()
    assert abs(entries(street)[one.name].distance_m - before) > 10.0


def test_changes_reach_the_list_through_the_depsgraph(street: Any) -> None:
    one = imported(street, "ACTOR", "car-04")
    before = entries(street)[one.name].distance_m
    one.location.x += 30.0
    bpy.context.view_layer.update()
    assert entries(street)[one.name].distance_m != pytest.approx(before, abs=5.0)
    one.hide_set(True)
    bpy.context.view_layer.update()
    assert entries(street)[one.name].hidden
    assert bpy.ops.unisim.hide_actor(name=one.name) == {"FINISHED"} and not one.hide_get()


def test_a_row_chooses_the_actor_and_jumps_to_where_it_is(street: Any) -> None:
    manager = bpy.context.window_manager.unisim_actors
    one = imported(street, "ACTOR", "car-03")
    from unisim_blender.bridge.objects.animation import write_presence

    write_presence(one, Clock.of(source_of(street).drive), (1.2, 1.6))
    listing.look_again()
    street.frame_set(3)
    row = entries(street)[one.name]
    assert not row.there and row.edited
    place = list(street.objects).index(one)
    manager.jump = False
    manager.place = place
    assert bpy.context.active_object == one and street.frame_current == 3
    manager.jump = True
    manager.place = place
    assert street.frame_current == 12 and bpy.context.selected_objects == [one] and manager.place == place
    bpy.ops.unisim.choose_actor(name=one.name, seconds=1.5)
    assert street.frame_current == 15
    select(imported(street, "ACTOR", "car-04"))
    one.select_set(False)
    assert manager.place != place


def test_the_list_filters_with_the_panels_settings(street: Any) -> None:
    manager = bpy.context.window_manager.unisim_actors
    assert len(shown(street)) == 20
    manager.group = "OTHER"
    assert len(shown(street)) == 5 and all(name.startswith("Cone") for name in shown(street))
    assert bpy.ops.unisim.select_listed() == {"FINISHED"}
    assert sorted(o.name for o in bpy.context.selected_objects) == sorted(shown(street))
    manager.text = "nothing"
    assert not shown(street) and not bpy.ops.unisim.select_listed.poll()
    assert bpy.ops.unisim.clear_actor_filter() == {"FINISHED"}
    assert len(shown(street)) == 20 and not bpy.ops.unisim.clear_actor_filter.poll()
    manager.order = "DISTANCE"
    away = [one.distance_m for one in listing.refresh_now(street).shown]
    assert away == sorted(away)
    manager.order = "NAME"


def test_rows_of_the_list_are_the_shown_actors_in_order(street: Any) -> None:
    manager = bpy.context.window_manager.unisim_actors
    manager.order = "DISTANCE"
    names = shown(street)
    flags, order = rows_of(street)
    assert sorted(order) == list(range(len(street.objects)))
    drawn = {place: one.name for flag, place, one in zip(flags, order, street.objects, strict=True) if flag}
    assert [drawn[place] for place in sorted(drawn)] == names and sorted(drawn) == list(range(len(names)))
    manager.order = "NAME"


def test_icons_are_blenders(addon: Any) -> None:
    icons = set(bpy.types.UILayout.bl_rna.functions["label"].parameters["icon"].enum_items.keys())
    assert {icon for *_, icon, _ in (*GROUPS, *ORDERS)} <= icons


def test_three_hundred_actors_take_little(street: Any) -> None:
    sources = list(imported_objects(street, "ACTOR"))
    collection = sources[0].users_collection[0]
    for number in range(280):
        copy = sources[number % len(sources)].copy()
        collection.objects.link(copy)
    bpy.context.view_layer.update()
    count = 300
    listing.look_again()
    assert calls(lambda: entries(street)) < 600 * count and len(entries(street)) == count
    street.frame_set(9)
    assert calls(lambda: listing.refresh_now(street)) < 80 * count
    assert calls(lambda: rows_of(street)) < 3 * count


def test_a_log_that_is_gone_leaves_an_empty_list(street: Any) -> None:
    entries(street)
    street.unisim.log, street.unisim.scene = "/nowhere/log", ""
    listing.look_again()
    table = listing.refresh_now(street)
    assert not table.entries and "/nowhere/log" in table.problem
    street.unisim.scene = str(SAMPLE / "scene")


def test_card_list_and_graph_say_the_same_speed(street: Any) -> None:
    """Keys between the frames, and noise of annotations: each place where a speed stands has one and the same."""
    one = driving_car(street)
    above, noise = trajectory_of(one), np.random.default_rng(3)
    keys = keys_of(above)
    assert keys is not None
    frames, positions, quaternions = keys
    every = np.arange(frames[0], frames[-1], 0.5)
    places = np.stack([np.interp(every, frames, column) for column in positions.T], -1)
    turns = np.tile(quaternions[:1], (len(every), 1))
    write_keys(above, every, places + noise.normal(0.0, 0.1, places.shape), turns)
    drive = source_of(street).drive
    graph = compared_now(one, drive, Clock.of(drive), Limits())
    for frame in (0, 7, 13, 19):
        street.frame_set(frame)
        entry = listing.refresh_now(street).entries[one.session_uid]
        card = card_of(street, one, drive)
        assert card.speed_m_s == pytest.approx(entry.speed_m_s, abs=1e-4)
        assert kmh(card.speed_m_s) == f"{speed_text(entry)} km/h" == values(graph, frame)[1][0]


def test_a_view_that_leaves_its_camera_for_an_actor_is_25_m_away(street: Any) -> None:
    car = driving_car(street)
    street.camera = None  # which has nothing in its image
    looks = SimpleNamespace(view_perspective="CAMERA", view_rotation=None, view_distance=3.0, view_location=None)
    area = SimpleNamespace(type="VIEW_3D", spaces=SimpleNamespace(active=SimpleNamespace(region_3d=looks)))
    context: Any = SimpleNamespace(area=area, scene=street)
    turn_to(context, car)
    assert (looks.view_perspective, looks.view_distance) == ("PERSP", 25.0)
    looks.view_distance = 80.0
    turn_to(context, car)
    assert looks.view_distance == 60.0 and tuple(looks.view_location) == tuple(car.matrix_world.translation)
