"""Mesh objects as the ego vehicle's body: on the vehicle, in scenarios and back, seen by those who
do not ride there."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import assert_alike, crate, drive_of, edited, imported, read, select, there_and_back

from unisim_blender.bridge.objects.ego_bodies import DISPLAY_KEY, bodies_differ, show_bodies, shown_as
from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.adjacent_frames import sample_now
from unisim_blender.core.geometry import invert_pose
from unisim_blender.core.meshes.read import read_mesh
from unisim_blender.core.scenario import load_scenario, save_scenario
from unisim_blender.core.scenario.edits import EgoBody
from unisim_blender.core.worker.server import Jobs
from unisim_blender.core.world.drive import Camera, Lidar
from unisim_blender.editing.reading.requests import camera_request
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.features.drive.export_operators import scenario_of


def body_of(scene: Any, **options: Any) -> Any:
    """A crate of 4 x 2 x 1.6 m as the ego vehicle's body."""
    box = crate((30.0, 12.0, 5.0), (2.0, 1.0, 0.8))
    select(box)
    assert bpy.ops.unisim.ego_body(**options) == {"FINISHED"}
    bpy.context.view_layer.update()
    return box


def bodies(scene: Any) -> list[EgoBody]:
    return [edit for edit in read(scene).edits if isinstance(edit, EgoBody)]


def told(scene: Any) -> dict[str, bool | None]:
    """What the scenario says of its cameras: whether they see it."""
    sensors = read(scene).sensors
    assert sensors is not None and sensors.cameras is not None
    return {spec.id: spec.sees_ego_body for spec in sensors.cameras}


def roadside(scene: Any, name: str = "roadside") -> Any:
    """A camera of the rig that stands beside the road, ahead of the vehicle and looking back at it."""
    bpy.ops.unisim.add_camera()
    camera = bpy.context.active_object
    camera.name, camera.parent = name, None
    ego = imported(scene, "EGO", "ego")
    at = np.array(ego.matrix_world.translation)
    camera.location = (at[0] + 9.0, at[1] + 3.0, at[2] + 1.5)
    camera.rotation_euler = (np.pi / 2, 0.0, np.arctan2(3.0, 8.0) + np.pi / 2)
    bpy.context.view_layer.update()
    return camera


def test_it_stands_on_the_vehicle_and_rides_along(street: Any) -> None:
    box = body_of(street)
    (edit,) = bodies(street)
    assert edit.id == box.name and edit.label == "Car"
    # its rear 1 m behind the vehicle's origin, its underside at the height of that
    np.testing.assert_allclose(edit.mount.position, [1.0, 0.0, 0.8], atol=1e-5)
    assert edit.mount.quaternion_wxyz is not None
    np.testing.assert_allclose(edit.mount.quaternion_wxyz, [1, 0, 0, 0], atol=1e-6)
    np.testing.assert_allclose(read_mesh((Path("/tmp") / edit.mesh).resolve()).size_m, [4, 2, 1.6], atol=1e-5)
    ego = imported(street, "EGO", "ego")
    places = []
    for frame in (0, 7, 15):
        street.frame_set(frame)
        on = np.array(ego.matrix_world.inverted() @ box.matrix_world)
        np.testing.assert_allclose(on[:3, 3], [1.0, 0.0, 0.8], atol=1e-4)
        places.append(box.matrix_world.translation.copy())
    assert (places[2] - places[0]).length > 5
    assert bpy.ops.unisim.shift_ego(left_m=2.0) == {"FINISHED"}
    drive, times = edited(street), np.linspace(0.0, 1.5, 7)
    on_ego = invert_pose(drive.world_from_ego.at(times)) @ drive.actors[box.name].world_from_actor.at(times)
    np.testing.assert_allclose(on_ego[:, :3, 3], np.tile([1.0, 0.0, 0.8], (7, 1)), atol=1e-4)
    # moved by hand on the vehicle, copied, hidden, released
    box.location.x += 0.5
    bpy.context.view_layer.update()
    np.testing.assert_allclose(bodies(street)[0].mount.position, [1.5, 0.0, 0.8], atol=1e-5)
    bpy.ops.object.duplicate()
    assert len(bodies(street)) == 2
    bpy.ops.object.delete()
    box.hide_render = True
    assert not bodies(street)
    box.hide_render = False
    world = np.array(box.matrix_world)
    assert bpy.ops.unisim.release_ego_body() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert not bodies(street) and box.parent is None and box.unisim.kind == "NONE"
    np.testing.assert_allclose(np.array(box.matrix_world), world, atol=1e-5)


def test_where_it_stands_and_of_several_parts(street: Any) -> None:
    street.frame_set(5)
    ego = imported(street, "EGO", "ego")
    at = np.array(ego.matrix_world.translation)
    body, wheel = (
        crate((at[0] + 1.0, at[1], 1.0), (2.0, 0.9, 0.7)),
        crate((at[0] + 2.0, at[1] + 0.9, 0.3), (0.3, 0.1, 0.3)),
    )
    before = np.array(wheel.matrix_world.translation)
    select(wheel, body)
    assert bpy.ops.unisim.ego_body(place="HERE", forward="X", label="Van") == {"FINISHED"}
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(wheel.matrix_world.translation), before, atol=1e-5)
    (edit,) = bodies(street)
    assert edit.id == body.name and edit.label == "Van" and wheel.parent == body
    np.testing.assert_allclose(edit.mount.position[:2], [1.0, 0.0], atol=0.3)
    assert len(read_mesh((Path("/tmp") / edit.mesh).resolve()).faces) == 24
    # the file of its shape is the same wherever the vehicle is
    files = set()
    for frame in (0, 9, 18):
        street.frame_set(frame)
        clock = Clock.of(source_of(street).drive).around(frame)
        sampled = sample_now(street, bpy.context.evaluated_depsgraph_get(), clock)
        files |= {obj.mesh for obj in sampled.of("BODY")}
    assert len(files) == 1


def test_sensors_say_whether_they_see_it(street: Any) -> None:
    camera = roadside(street)
    assert set(told(street).values()) == {None}
    body_of(street)
    bpy.ops.unisim.add_camera()
    mounted = bpy.context.active_object
    mounted.name = "mounted"
    bpy.ops.unisim.add_camera()
    gimbal = bpy.context.active_object
    gimbal.name = "gimbal"
    for frame, yaw in ((0, 0.0), (15, 1.0)):
        gimbal.rotation_euler.z = yaw
        gimbal.keyframe_insert("rotation_euler", frame=frame)
    drive = edited(street)
    every: list[Camera | Lidar] = [*drive.cameras.values(), *drive.lidars.values()]
    sees = {sensor.sensor_id: sensor.sees_ego_body for sensor in every}
    assert sees == {"front_camera": False, "mounted": False, "gimbal": False, "roadside": True, "pandar64": False}
    assert told(street) == {"front_camera": None, "mounted": None, "gimbal": False, "roadside": None}
    mounted.unisim.sees_ego_body = "ALWAYS"
    assert told(street)["mounted"] is True
    # a constraint may hold it on the vehicle, too
    constraint = camera.constraints.new("CHILD_OF")
    constraint.target = imported(street, "EGO", "ego")
    assert not edited(street).cameras["roadside"].sees_ego_body


def test_what_is_refused(street: Any) -> None:
    box = body_of(street)
    box.parent = None
    with pytest.raises(
        RuntimeError, match=f'object "{box.name}": moves on the ego vehicle, which its body is fixed to'
    ):
        bpy.ops.unisim.export_scenario(filepath="/tmp/never.json")
    assert bpy.ops.unisim.release_ego_body() == {"FINISHED"}
    box.keyframe_insert("location", frame=0)
    select(box)
    with pytest.raises(RuntimeError, match=f'object "{box.name}": has keys or constraints'):
        bpy.ops.unisim.ego_body()
    empty = bpy.data.objects.new("nothing", None)
    street.collection.objects.link(empty)
    select(empty)
    with pytest.raises(RuntimeError, match="no selected object has a surface"):
        bpy.ops.unisim.ego_body()
    assert not bpy.ops.unisim.release_ego_body.poll() and box.unisim.kind == "NONE"


def test_there_and_back_with_a_chase_camera(scene: Any, street: Any, tmp_path: Path) -> None:
    body_of(street)
    roadside(street)
    bpy.ops.unisim.add_camera(mount=(-8.0, 0.0, 3.0))
    bpy.context.active_object.name = "chase"
    bpy.context.active_object.unisim.sees_ego_body = "ALWAYS"
    first = scenario_of(street, tmp_path / "first.json")
    from unisim_blender.editing.reading.scenario import write_scenario

    write_scenario(first, tmp_path / "first.json")
    (kept,) = (edit for edit in load_scenario(tmp_path / "first.json").edits if isinstance(edit, EgoBody))
    assert kept.mesh.startswith("first_meshes/") and (tmp_path / kept.mesh).is_file()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    again = there_and_back(tmp_path / "first.json", tmp_path)
    before, after = drive_of(tmp_path / "first.json"), drive_of(again)
    one, other = before.actors[kept.id], after.actors[kept.id]
    assert Path(one.appearance.mesh).name == Path(other.appearance.mesh).name
    after.actors[kept.id] = replace(other, appearance=one.appearance)
    assert_alike(before, after)
    assert {name: camera.sees_ego_body for name, camera in after.cameras.items()} == {
        "front_camera": False, "chase": True, "roadside": True,
    }  # fmt: skip
    save_scenario(load_scenario(again), tmp_path / "copy.json")


def test_what_an_edit_of_it_changes_is_seen_from_outside_alone(street: Any, tmp_path: Path) -> None:
    box, source, frame = body_of(street), source_of(street), street.frame_current
    outside = roadside(street)
    clock, jobs = Clock.of(source.drive).around(frame), Jobs(tmp_path)

    def regions(number: int) -> dict[str, Any]:
        sampled = sample_now(street, bpy.context.evaluated_depsgraph_get(), clock, ())
        found = {}
        for i, view in enumerate(view for view in sampled.objects if view.kind == "CAMERA"):
            request = camera_request(sampled, view, source, frame, (160, 90)).values
            update = {"job": number + i - 10, "unfinished": []}
            found[view.name] = next(jobs.camera({**request, "id": number + i, "update": update}))["regions"]
        return found

    assert all(parts == [(0, 0, 160, 90)] for parts in regions(10).values())
    box.location.z += 0.4
    bpy.context.view_layer.update()
    found = regions(20)
    assert found["front_camera"] == [] and found[outside.name] not in ([], [(0, 0, 160, 90)])


def test_views_through_cameras_on_the_vehicle_do_not_draw_it(street: Any) -> None:
    box, outside = body_of(street), roadside(street)
    part = crate((0.0, 0.0, 1.0))
    part.parent, part.display_type = box, "WIRE"
    front = street.camera = imported(street, "CAMERA", "front_camera")
    assert [shown_as(street, views) for views in ((front, front), (front, None), (outside,), (None,), ())] == [
        "HIDDEN", "BOUNDS", "SHOWN", "SHOWN", "SHOWN",
    ]  # fmt: skip
    layers = list(street.view_layers)
    for wanted, hidden, drawn in (("HIDDEN", True, "WIRE"), ("BOUNDS", False, "BOUNDS"), ("HIDDEN", True, "WIRE")):
        assert bodies_differ(street, wanted)
        show_bodies(street, wanted, layers)
        assert not bodies_differ(street, wanted)
        assert (part.hide_get(), part.display_type) == (hidden, drawn) and box.hide_get() == hidden
        # hidden in views alone: the scenario has it
        assert len(bodies(street)) == 1
    show_bodies(street, "SHOWN", layers)
    assert (part.hide_get(), part.display_type, box.display_type) == (False, "WIRE", "TEXTURED")
    assert DISPLAY_KEY not in part and not bodies_differ(street, "SHOWN")
    # what a person hides stays hidden
    box.hide_set(True)
    show_bodies(street, "BOUNDS", layers)
    show_bodies(street, "SHOWN", layers)
    assert box.hide_get()


def test_the_front_cameras_image_is_the_same_to_the_byte(street: Any, tmp_path: Path) -> None:
    """F12 with a body and without; a camera beside the road shows it."""
    street.render.engine = "UNISIM"
    outside = roadside(street)
    front = imported(street, "CAMERA", "front_camera")
    street.render.resolution_percentage = 50

    def render(camera: Any, name: str) -> Any:
        street.camera = camera
        street.render.filepath = str(tmp_path / name)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(str(tmp_path / f"{name}.png"))
        return np.array(image.pixels[:], np.float32).reshape(image.size[1], image.size[0], 4)

    before = render(front, "a"), render(outside, "b")
    body_of(street)
    after = render(front, "c"), render(outside, "d")
    assert before[0].tobytes() == after[0].tobytes()
    red = (after[1][..., 0] - after[1][..., 1] > 0.1) & (np.abs(after[1] - before[1]).max(-1) > 0.05)
    assert red.sum() > 500
