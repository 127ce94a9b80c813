"""Gizmos: when they are there, and what the operators that they start write to the scene."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import driving_car, edited, read, select
from mathutils import Matrix, Vector

from unisim_blender.bridge.changes.handles import TransformSnapshot, displace_at, handles_of
from unisim_blender.bridge.objects.animation import curves_of
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.sensors import direction_of
from unisim_blender.bridge.views.trails import trajectory_poses
from unisim_blender.core.geometry import FloatArray, invert_pose
from unisim_blender.core.scenario.edits import Ego, Move
from unisim_blender.editing.motion.keys import BLEND_S, HANDLE_LIMIT
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sensors.mounts import angles
from unisim_blender.features.motion import gizmos
from unisim_blender.features.motion.drag import TARGET_M, target_of
from unisim_blender.operators import menus
from unisim_blender.registering import classes_of

RIG, FREE = "CAMERA", "PERSP"


def clock_of(scene: Any) -> Clock:
    """The drive's clock."""
    return Clock.of(source_of(scene).drive)


def seen_from(scene: Any, perspective: str = FREE, **space: Any) -> Any:
    """A context as a 3D view has it, which looks freely or through the camera."""
    view = {"show_gizmo": True, "show_object_viewport_empty": True, **space}
    looks = SimpleNamespace(view_perspective=perspective)
    active = bpy.context.active_object
    return SimpleNamespace(
        scene=scene, mode="OBJECT", active_object=active, space_data=SimpleNamespace(region_3d=looks, **view)
    )


def shown(scene: Any, **how: Any) -> list[str]:
    """Which groups of gizmos a view shows."""
    context = seen_from(scene, **how)
    groups = [cls for cls in classes_of(gizmos) if issubclass(cls, bpy.types.GizmoGroup)]
    return [group.bl_label for group in groups if group.poll(context)]


def world_offset(scene: Any, one: Any, before: FloatArray) -> FloatArray:
    """How far (N, 3) an object is from where it was, in the world at the clock's frames."""
    trajectory = trajectory_poses(one, clock_of(scene))
    assert trajectory is not None
    return np.asarray((trajectory - before)[:, :3, 3])


def test_which_are_shown(street: Any) -> None:
    select()
    bpy.context.view_layer.objects.active = None
    assert shown(street) == ["Ego Lane"]
    driving_car(street)
    assert shown(street) == ["Ego Lane", "Trajectory"]
    select(street.camera)
    assert shown(street) == ["Ego Lane", "Sensor Direction"]
    select(next(imported_objects(street, "LIDAR")))
    assert shown(street) == ["Ego Lane", "Sensor Direction"]
    standing = next(o for o in imported_objects(street, "ACTOR") if o.parent is None)
    select(standing)
    assert shown(street) == ["Ego Lane"]


def test_off_through_a_recorded_camera(street: Any) -> None:
    driving_car(street)
    assert shown(street, perspective=RIG) == []
    street.unisim_motion.gizmos_in_cameras = True
    assert shown(street, perspective=RIG) == ["Ego Lane", "Trajectory"]
    select(street.camera)
    assert shown(street, perspective=RIG) == ["Ego Lane"], "a camera cannot be aimed while it is looked through"


def test_switches(street: Any) -> None:
    driving_car(street)
    assert shown(street, show_gizmo=False) == []
    assert shown(street, show_object_viewport_empty=False) == ["Trajectory"]
    street.unisim.show_ways = False
    assert shown(street) == ["Ego Lane"]
    street.unisim_motion.show_gizmos = False
    assert shown(street) == []


def test_none_without_a_drive(scene: Any) -> None:
    assert shown(scene) == []


def test_the_lane_that_a_drag_writes(street: Any) -> None:
    assert bpy.ops.unisim.drag_ego(left_m=1.25) == {"FINISHED"}
    (edit,) = read(street).edits
    assert isinstance(edit, Ego) and edit.shift_left_m == pytest.approx(1.25, abs=1e-4)
    assert bpy.ops.unisim.drag_ego(left_m=-0.5) == {"FINISHED"}
    (edit,) = read(street).edits
    assert isinstance(edit, Ego) and edit.shift_left_m == pytest.approx(0.75, abs=1e-4)


def test_handles_are_on_the_trajectory(street: Any) -> None:
    one, clock = driving_car(street), clock_of(street)
    found = handles_of(one, clock)
    assert [handle.time_s for handle in found] == [0.0, 1.0] and not any(handle.is_key for handle in found)
    street.frame_set(int(clock.frame(np.array(1.0))))
    assert found[1].place == pytest.approx(np.array(one.matrix_world.translation), abs=0.02)
    displace_at(one, 0.6, np.array([0.0, 1.0, 0.0]), clock)
    found = handles_of(one, clock)
    assert [(round(h.time_s, 3), h.is_key) for h in found] == [(0.0, False), (0.6, True), (1.0, False)]
    assert not handles_of(next(o for o in imported_objects(street, "ACTOR") if o.parent is None), clock)


def test_a_drag_that_begins_in_the_middle_of_an_actor_is_for_the_actor(street: Any) -> None:
    one, clock = driving_car(street), clock_of(street)
    street.frame_set(10)

    def times() -> list[float]:
        return [round(handle.time_s, 3) for handle in gizmos.shown_handles(bpy.context)]

    assert times() == [0.0]
    displace_at(one, 1.0, np.array([0.0, 1.0, 0.0]), clock)
    assert times() == [0.0, 1.0], "a key keeps its handle"


def test_a_long_drive_has_few_handles(street: Any) -> None:
    one = driving_car(street)
    clock = Clock(np.arange(801.0), np.arange(801.0) / 10)
    assert 8 <= len(handles_of(one, clock)) <= HANDLE_LIMIT


def test_a_drag_displaces_at_its_time_and_blends(street: Any) -> None:
    one, clock = driving_car(street), clock_of(street)
    before = trajectory_poses(one, clock)
    street.frame_set(3)
    assert bpy.ops.unisim.drag_trajectory(time_s=1.0, offset_m=(0.5, 1.0, 0.0)) == {"FINISHED"}
    assert before is not None
    apart = world_offset(street, one, before)
    at = int(np.argmin(np.abs(clock.times_s - 1.0)))
    assert apart[at] == pytest.approx([0.5, 1.0, 0.0], abs=2e-3)
    sizes = np.linalg.norm(apart, axis=1)
    assert sizes.argmax() == at and (np.diff(sizes[: at + 1]) > 0).all() and (np.diff(sizes[at:]) < 0).all()
    assert np.abs(np.diff(sizes)).max() < 0.15, "it jumps"
    (curve,) = [c for c in curves_of(one) if c.data_path == "location" and c.array_index == 1]
    times = clock.time_s(np.array([key.co[0] for key in curve.keyframe_points]))
    assert times == pytest.approx([1.0 - BLEND_S, 1.0, 1.0 + BLEND_S], abs=1e-3)
    (edit,) = read(street).edits
    assert isinstance(edit, Move) and edit.actor == one.unisim.uid
    time = float(clock.times_s[at])
    recorded, now = source_of(street).drive.actors[edit.actor], edited(street).actors[edit.actor]
    moved = (now.world_from_actor.at(time) - recorded.world_from_actor.at(time))[:3, 3]
    assert moved == pytest.approx([0.5, 1.0, 0.0], abs=2e-3)


def test_the_same_handle_again_is_the_same_key(street: Any) -> None:
    one, clock = driving_car(street), clock_of(street)
    before = trajectory_poses(one, clock)
    for _ in range(3):
        displace_at(one, 1.0, np.array([0.0, 0.5, 0.0]), clock)
    assert [len(c.keyframe_points) for c in curves_of(one) if c.data_path == "location"] == [3, 3, 3]
    at = int(np.argmin(np.abs(clock.times_s - 1.0)))
    assert before is not None and world_offset(street, one, before)[at] == pytest.approx([0.0, 1.5, 0.0], abs=2e-3)


def test_another_handle_leaves_the_first_where_it_is(street: Any) -> None:
    one, clock = driving_car(street), clock_of(street)
    before = trajectory_poses(one, clock)
    displace_at(one, 0.5, np.array([0.0, 1.0, 0.0]), clock)
    displace_at(one, 1.5, np.array([0.0, -1.0, 0.0]), clock)
    assert before is not None
    apart = world_offset(street, one, before)
    assert apart[int(np.argmin(np.abs(clock.times_s - 0.5)))] == pytest.approx([0.0, 1.0, 0.0], abs=3e-3)
    (curve,) = [c for c in curves_of(one) if c.data_path == "location" and c.array_index == 1]
    times = clock.time_s(np.array([key.co[0] for key in curve.keyframe_points]))
    assert times == pytest.approx([-1.5, 0.5, 1.5, 2.5], abs=1e-3)  # each change ends at the key next to it


def test_a_displacement_of_the_whole_is_where_it_starts(street: Any) -> None:
    one, clock = driving_car(street), clock_of(street)
    one.location = (0.0, 2.0, 0.0)
    bpy.context.view_layer.update()
    displace_at(one, 1.0, np.array([0.0, 1.0, 0.0]), clock)
    (curve,) = [c for c in curves_of(one) if c.data_path == "location" and c.array_index == 1]
    assert [key.co[1] for key in curve.keyframe_points] == pytest.approx([2.0, 3.0, 2.0], abs=1e-3)


def keys_of_place(one: Any) -> list[Any]:
    """The keys of an object's location."""
    return [key for c in curves_of(one) if c.data_path == "location" for key in c.keyframe_points]


def test_esc_puts_everything_back(street: Any) -> None:
    one, clock = driving_car(street), clock_of(street)
    kept = TransformSnapshot.of(one)
    displace_at(one, 1.0, np.array([0.0, 1.0, 0.0]), clock)
    kept.restore(one)
    assert not [c for c in curves_of(one) if c.data_path == "location"] and not read(street).edits
    displace_at(one, 1.0, np.array([0.0, 1.0, 0.0]), clock)
    for key in keys_of_place(one):  # not what Blender makes of new keys
        key.interpolation, key.handle_left_type = "LINEAR", "VECTOR"
    shapes = [[c.evaluate(f) for f in np.linspace(-5, 25, 40)] for c in curves_of(one)]
    kept = TransformSnapshot.of(one)
    displace_at(one, 1.6, np.array([0.0, 1.0, 0.0]), clock)
    displace_at(one, 1.0, np.array([0.0, 1.0, 0.0]), clock)
    kept.restore(one)
    assert [[c.evaluate(f) for f in np.linspace(-5, 25, 40)] for c in curves_of(one)] == shapes
    assert [(key.interpolation, key.handle_left_type) for key in keys_of_place(one)] == [("LINEAR", "VECTOR")] * 9


def test_what_stands_still_has_no_handles(street: Any) -> None:
    select(next(o for o in imported_objects(street, "ACTOR") if o.parent is None))
    assert not bpy.ops.unisim.drag_trajectory.poll()


@pytest.mark.parametrize("kind", ["CAMERA", "LIDAR"])
def test_aiming_a_sensor_turns_its_mount(street: Any, kind: str) -> None:
    sensor = next(imported_objects(street, kind))
    select(sensor)
    yaw, pitch = np.degrees(direction_of(sensor))
    place = tuple(sensor.location)
    street.frame_set(6)
    assert bpy.ops.unisim.drag_aim(yaw_deg=yaw + 20.0, pitch_deg=pitch - 5.0) == {"FINISHED"}
    assert tuple(sensor.location) == place
    now, before = edited(street), source_of(street).drive
    uid = sensor.unisim.uid
    axis = np.array([0.0, 0.0, 1.0]) if kind == "CAMERA" else np.array([1.0, 0.0, 0.0])
    for time in (0.5, 1.5):
        looks = []
        for drive in (before, now):
            trajectory = (
                drive.cameras[uid].world_from_camera if kind == "CAMERA" else drive.lidars[uid].world_from_lidar
            )
            looks.append(
                np.degrees(angles((invert_pose(drive.world_from_ego.at(time)) @ trajectory.at(time))[:3, :3] @ axis))
            )
        assert looks[1] - looks[0] == pytest.approx(
            [20.0, -5.0], abs=0.1
        )  # the vehicle sways between its time and the sensor's
    (spec,) = now_sensors(street, kind)
    assert spec.mount_offset is not None and spec.trajectory is None


def now_sensors(scene: Any, kind: str) -> Any:
    """The specifications of the edited sensors of a kind."""
    sensors = read(scene).sensors
    assert sensors is not None
    return sensors.cameras if kind == "CAMERA" else sensors.lidars


def test_a_new_camera_too(street: Any) -> None:
    bpy.ops.unisim.add_camera(yaw_deg=30.0, pitch_deg=2.0)
    camera = bpy.context.active_object
    assert np.degrees(direction_of(camera)) == pytest.approx([30.0, 2.0], abs=1e-3)
    assert bpy.ops.unisim.aim_sensor(yaw_deg=-40.0, pitch_deg=-10.0) == {"FINISHED"}
    bpy.context.view_layer.update()
    assert np.degrees(direction_of(camera)) == pytest.approx([-40.0, -10.0], abs=1e-3)
    assert camera.rotation_mode == "XYZ" and camera.rotation_euler.y == pytest.approx(0.0, abs=1e-4)
    ahead = target_of(camera) - np.array(camera.matrix_world.translation)
    assert np.linalg.norm(ahead) == pytest.approx(TARGET_M, abs=1e-5)
    camera.keyframe_insert("rotation_euler", frame=3)
    assert not bpy.ops.unisim.aim_sensor.poll()


def test_hit_areas_are_small() -> None:
    """Of a view straight down whose pixels are centimetres: the disc, and the outer part of the arrow."""
    looks = SimpleNamespace(perspective_matrix=Matrix.Diagonal((0.5, 0.5, 0.5, 1.0)))
    system = SimpleNamespace(ui_scale=1.0)
    context = SimpleNamespace(
        region=SimpleNamespace(width=400, height=400), region_data=looks, preferences=SimpleNamespace(system=system)
    )
    reach = lambda context: gizmos.HIT_PX  # noqa: E731
    dot: Any = SimpleNamespace(matrix_world=Matrix.Translation((1.0, 0.0, 0.0)), reach=reach)
    hit: Any = gizmos.UNISIM_GT_dot.test_select
    assert hit(dot, context, (304, 203)) == 0 and hit(dot, context, (312, 200)) == -1
    arrow: Any = SimpleNamespace(matrix_world=gizmos.standing(Vector((0, 0, 0)), Vector((0, 1, 0))), reach=reach)
    hit = gizmos.UNISIM_GT_arrow.test_select
    assert hit(arrow, context, (203, 280)) == 0 and hit(arrow, context, (200, 306)) == 0
    assert hit(arrow, context, (200, 210)) == -1, "the vehicle's place stays free"
    assert hit(arrow, context, (215, 260)) == -1 and hit(arrow, context, (200, 312)) == -1


def test_the_pie_has_eight_slots_for_each_kind(street: Any) -> None:
    assert {"ACTOR", "EGO", "CAMERA", "LIDAR", "STATIC", "NONE"} == set(menus.SLOTS)
    for slots in menus.SLOTS.values():
        assert len(slots) == 8
        for slot in slots:
            if slot is not None:
                group, name = slot.operator.split(".")
                assert getattr(getattr(bpy.ops, group), name).get_rna_type()
    driving_car(street)
    assert menus.kind_of_active(bpy.context) == "ACTOR"
    select(next(imported_objects(street, "EGO")))
    assert menus.kind_of_active(bpy.context) == "EGO"
    select()
    assert menus.kind_of_active(bpy.context) == "NONE"
