"""Ordinary meshes as actors: marked, read with colours and parts, edited like the rest, into scenarios and back."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
import trimesh
from helpers import (
    SAMPLE,
    assert_alike,
    crate,
    drive_of,
    edited,
    ended,
    imported,
    material,
    read,
    select,
    there_and_back,
)

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.sampling.from_keys import sample_steps
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.meshes.model import MeshModel
from unisim_blender.core.meshes.read import read_mesh
from unisim_blender.core.scenario import load_scenario
from unisim_blender.core.scenario.edits import InsertMesh
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import CHANGING, rigid


def mark(*objects: Any, **options: Any) -> None:
    select(*objects)
    assert bpy.ops.unisim.mesh_actor(**options) == {"FINISHED"}


def inserted(scene: Any) -> list[InsertMesh]:
    return [edit for edit in read(scene).edits if isinstance(edit, InsertMesh)]


def model(edit: InsertMesh) -> MeshModel:
    return read_mesh((Path("/tmp") / edit.mesh).resolve())


def test_a_marked_mesh_is_inserted_with_its_colours(street: Any) -> None:
    box = crate((14.0, 1.0, 0.5), (2.0, 1.0, 0.5))
    assert not inserted(street)
    mark(box, label="Car")
    (edit,) = inserted(street)
    assert edit.label == "Car" and edit.id == box.name and edit.pose is not None
    np.testing.assert_allclose(edit.pose.position, [14, 1, 0.5], atol=1e-5)
    made = model(edit)
    np.testing.assert_allclose(made.size_m, [4, 2, 1], atol=1e-5)
    up = (made.normals[..., 2] > 0.9).all(1)
    np.testing.assert_allclose(made.colours[up], np.broadcast_to([0.1, 0.6, 0.1], made.colours[up].shape), atol=1e-6)
    np.testing.assert_allclose(made.colours[~up], np.broadcast_to([0.6, 0.1, 0.1], made.colours[~up].shape), atol=1e-6)
    actor = edited(street).actors[box.name]
    assert actor.inserted and actor.appearance.mesh and not actor.is_moving
    select(box)
    assert bpy.ops.unisim.release_mesh() == {"FINISHED"}
    assert not inserted(street)


def test_a_mesh_whose_scale_changes_over_time_is_refused_however_the_scene_is_sampled(street: Any) -> None:
    box = crate((14.0, 1.0, 0.5))
    mark(box, label="Car")
    for frame, factor in ((0, 1.0), (10, 1.4)):
        box.scale = (factor,) * 3
        box.keyframe_insert("scale", frame=frame)
    clock = Clock.of(source_of(street).drive)
    for sampled in (sample_all(street, clock), ended(sample_steps(street, clock))):
        assert next(obj for obj in sampled.objects if obj.name == box.name).scaling.fault == CHANGING


@pytest.mark.parametrize("forward, ahead", [("AUTO", (0, 1)), ("X", (1, 0)), ("-X", (-1, 0)), ("-Y", (0, -1))])
def test_it_points_where_it_is_told_to_and_stays_where_it_is(street: Any, forward: str, ahead: tuple[int, int]) -> None:
    box = crate((20.0, -2.0, 1.0), (0.5, 2.0, 0.5))
    box.rotation_euler = (np.pi / 2, 0.0, 0.3)  # as importers leave models, and a little aside
    bpy.context.view_layer.update()
    matrix = np.array(box.matrix_world)
    before = np.array([v.co for v in box.data.vertices]) @ matrix[:3, :3].T + matrix[:3, 3]
    mark(box, forward=forward)
    bpy.context.view_layer.update()
    matrix = np.array(box.matrix_world)
    after = np.array([v.co for v in box.data.vertices]) @ matrix[:3, :3].T + matrix[:3, 3]
    np.testing.assert_allclose(after, before, atol=1e-5)
    np.testing.assert_allclose(matrix[:3, 0], [*ahead, 0], atol=1e-6)
    np.testing.assert_allclose(matrix[:3, 2], [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(matrix[:3, 3], (before.min(0) + before.max(0)) / 2, atol=1e-5)


def test_a_model_of_many_parts_is_one_actor(street: Any) -> None:
    body, wheel = crate((10.0, 0.0, 1.0), (2.0, 1.0, 0.5)), crate((11.0, 1.0, 0.3), (0.3, 0.1, 0.3))
    empty = bpy.data.objects.new("toy", None)
    street.collection.objects.link(empty)
    empty.location = (9.0, 0.0, 0.0)
    empty.scale = (0.5, 0.5, 0.5)
    bpy.context.view_layer.update()
    for part in (body, wheel):
        part.parent = empty
    bpy.context.view_layer.update()
    wheel_at = np.array(wheel.matrix_world.translation)
    mark(empty, body, wheel)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(wheel.matrix_world.translation), wheel_at, atol=1e-5)
    (edit,) = inserted(street)
    assert edit.id == "toy" and len(model(edit).faces) == 24
    size = model(edit).size_m
    empty.location.x += 3.0
    street.frame_set(street.frame_current)
    (moved,) = inserted(street)
    assert moved.mesh == edit.mesh and moved.pose is not None and edit.pose is not None
    np.testing.assert_allclose(np.subtract(moved.pose.position, edit.pose.position), [3, 0, 0], atol=1e-5)
    # all of it is copied, and all of it deleted
    select(empty)
    assert bpy.ops.unisim.duplicate_actor(where="LEFT") == {"FINISHED"}
    bpy.context.view_layer.update()
    assert len(inserted(street)) == 2 and len({edit.mesh for edit in inserted(street)}) == 1
    copy = bpy.context.active_object
    beside = np.array(copy.matrix_world.translation - empty.matrix_world.translation)
    assert abs(beside[1] - size[1] - 0.6) < 1e-4
    count = len(bpy.data.objects)
    assert bpy.ops.unisim.delete_actor() == {"FINISHED"}
    assert len(inserted(street)) == 1 and len(bpy.data.objects) == count - 3


def test_keys_hiding_and_warnings(street: Any) -> None:
    box = crate((10.0, 0.0, 1.0), (2.0, 1.0, 0.5))
    mark(box, label="Car")
    for frame, x in ((0, 10.0), (10, 14.0)):
        box.location.x = x
        box.keyframe_insert("location", frame=frame)
    (edit,) = inserted(street)
    assert edit.trajectory is not None
    actor = edited(street).actors[box.name]
    t = source_of(street).drive.time_s
    np.testing.assert_allclose(actor.world_from_actor.at(t[5])[:3, 3], [12, 0, 1.0], atol=0.6)
    assert actor.is_moving
    clock = Clock.of(source_of(street).drive)
    other = imported(street, "ACTOR", "car-12")
    box.animation_data_clear()
    box.location = other.matrix_world.translation
    street.frame_set(0)
    found = list(warnings_of(sample_all(street, clock), source_of(street).drive))
    assert any(box.name == finding.name or box.name in finding.text for finding in found)
    box.hide_render = True
    assert not inserted(street)


def test_textures_and_painted_colours(street: Any) -> None:
    bpy.ops.mesh.primitive_plane_add(size=2.0, location=(10, 0, 1))
    quad = bpy.context.active_object
    image = bpy.data.images.new("checks", 4, 2)
    values = np.linspace(0, 1, 4 * 2 * 4).reshape(2, 4, 4).astype(np.float32)
    image.pixels.foreach_set(values.ravel())
    made = material("checks", (1, 1, 1))
    node = made.node_tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    made.node_tree.links.new(node.outputs["Color"], made.node_tree.nodes["Principled BSDF"].inputs["Base Color"])
    quad.data.materials.append(made)
    mark(quad)
    (edit,) = inserted(street)
    found = model(edit)
    assert found.texture.tolist() == [0, 0] and len(found.textures) == 1
    np.testing.assert_array_equal(found.textures[0], np.rint(values[::-1, :, :3] * 255).astype(np.uint8))
    assert found.uv.min() >= 0 and found.uv.max() <= 1 and np.ptp(found.uv) == 1
    # painted: no material, a colour attribute
    quad.data.materials.clear()
    paint = quad.data.color_attributes.new("Color", "FLOAT_COLOR", "POINT")
    paint.data.foreach_set("color", np.tile([0.2, 0.3, 0.4, 1.0], 4).astype(np.float32))
    quad.data.color_attributes.active_color = paint
    found = model(inserted(street)[0])
    np.testing.assert_allclose(found.colours.reshape(-1, 3), np.tile([0.2, 0.3, 0.4], (6, 1)), atol=1e-6)


def test_an_actor_without_a_surface_is_refused(street: Any) -> None:
    box = crate((10.0, 0.0, 1.0))
    mark(box)
    box.data.clear_geometry()
    with pytest.raises(RuntimeError, match=f'object "{box.name}": is an actor without any surface'):
        bpy.ops.unisim.export_scenario(filepath="/tmp/never.json")
    empty = bpy.data.objects.new("nothing", None)
    street.collection.objects.link(empty)
    select(empty)
    with pytest.raises(RuntimeError, match="no selected object has a surface"):
        bpy.ops.unisim.mesh_actor()


def test_there_and_back_in_files_of_its_own(scene: Any, tmp_path: Path) -> None:
    box = trimesh.creation.box([2.0, 1.0, 1.0])
    box.visual.face_colors = [200, 30, 30, 255]
    box.export(tmp_path / "box.ply")
    text = (SAMPLE / "scenario.json").read_text()
    edit = (
        '{"type": "insert_mesh", "mesh": "' + str(tmp_path / "box.ply") + '", "id": "box", "label": "Car",'
        ' "trajectory": [{"frame": 3, "position": [20, 3, 0.7]}, {"frame": 9, "position": [30, 4, 0.7], "yaw_deg": 20}]},'
    )
    text = text.replace('"edits": [', f'"edits": [{edit}').replace('"scene": "scene"', f'"scene": "{SAMPLE / "scene"}"')
    (tmp_path / "a.json").write_text(text)
    again = there_and_back(tmp_path / "a.json", tmp_path)
    (kept,) = (edit for edit in load_scenario(again).edits if isinstance(edit, InsertMesh))
    assert kept.mesh.startswith("again_meshes/") and (tmp_path / kept.mesh).is_file()
    before, after = drive_of(tmp_path / "a.json"), drive_of(again)
    one, other = read_mesh(tmp_path / "box.ply"), read_mesh(tmp_path / kept.mesh)
    np.testing.assert_allclose(other.size_m, one.size_m, atol=1e-6)
    np.testing.assert_allclose(other.colours, one.colours, atol=1e-6)
    np.testing.assert_allclose(other.vertices[other.faces], one.vertices[one.faces], atol=1e-6)
    np.testing.assert_allclose(other.normals, one.normals, atol=2e-3)
    look = before.actors["box"].appearance
    after.actors["box"] = type(after.actors["box"])(**{**vars(after.actors["box"]), "appearance": look})
    assert_alike(before, after)
    # and again: the same files
    bpy.ops.wm.read_factory_settings(use_empty=True)
    third = there_and_back(again, tmp_path / "third")
    (last,) = (edit for edit in load_scenario(third).edits if isinstance(edit, InsertMesh))
    assert Path(last.mesh).name == Path(kept.mesh).name


def test_the_image_shows_it(street: Any, tmp_path: Path) -> None:
    """F12 of a marked crate before the camera: redder there than without."""
    street.render.engine = "UNISIM"
    street.render.resolution_percentage = 25
    camera = street.camera
    pose = rigid(np.array(camera.matrix_world, float))
    at = pose[:3, 3] - pose[:3, 2] * 12.0

    def render(name: str) -> Any:
        street.render.filepath = str(tmp_path / name)
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(str(tmp_path / f"{name}.png"))
        values = np.array(image.pixels[:]).reshape(image.size[1], image.size[0], -1)
        return values[..., :3]

    before = render("before")
    box = crate(tuple(at))
    mark(box)
    after = render("after")
    h, w = before.shape[:2]
    middle = slice(h // 2 - 3, h // 2 + 4), slice(w // 2 - 3, w // 2 + 4)
    assert (after[middle][..., 0] - after[middle][..., 1]).mean() > 0.1
    np.testing.assert_array_equal(after[: h // 8], before[: h // 8])
