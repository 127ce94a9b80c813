"""A drive in a Blender scene: where its objects are, that a second import changes nothing, that files keep it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import SAMPLE, imported, read

from unisim_blender.bridge.importing.drive import import_source
from unisim_blender.bridge.objects.animation import keys_of
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.trajectories import trajectory_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.errors import UnisimError
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import optical, same
from unisim_blender.editing.sampled.source import open_source, summary


def test_everything_of_the_drive_is_there(street: Any) -> None:
    drive = source_of(street).drive
    assert {t.unisim.uid for t in imported_objects(street, "ACTOR")} == set(drive.actors)
    assert {t.unisim.uid for t in imported_objects(street, "CAMERA")} == set(drive.cameras)
    assert {t.unisim.uid for t in imported_objects(street, "LIDAR")} == set(drive.lidars)
    assert len(list(imported_objects(street, "EGO"))) == 1
    assert street.camera is not None


def test_objects_stand_where_the_drive_has_them(street: Any) -> None:
    drive = source_of(street).drive
    clock = Clock.of(drive)
    sampled = sample_all(street, clock)
    checked = 0
    for one in sampled.objects:
        if one.kind == "ACTOR":
            actor = drive.actors[one.uid]
            times = clock.times_s if actor.is_moving else clock.times_s[:1].repeat(len(clock.times_s))
            poses = actor.world_from_actor.at(times)
        elif one.kind == "EGO":
            poses = drive.world_from_ego.at(clock.times_s)
        elif one.kind == "CAMERA":
            camera = drive.cameras[one.uid]
            known = [i for i, frame in enumerate(clock.frames) if int(frame) in camera.time_s]
            poses = optical(camera.world_from_camera.at(np.array([camera.time_s[int(clock.frames[i])] for i in known])))
            assert same(one.poses[known], poses).all(), one.name
            continue
        else:
            continue
        assert same(one.poses, poses).all(), one.name
        checked += 1
    assert checked > 5


def test_frame_n_is_the_logs_frame_n_at_its_rate(street: Any) -> None:
    drive = source_of(street).drive
    assert (street.frame_start, street.frame_end) == (drive.frames[0], drive.frames[-1])
    rate = (len(drive.time_s) - 1) / (max(drive.time_s.values()) - min(drive.time_s.values()))
    assert street.render.fps / street.render.fps_base == pytest.approx(rate, rel=0.2)


def test_keys_are_linear_and_turns_are_quaternions(street: Any) -> None:
    moving = [t for t in imported_objects(street, "ACTOR") if trajectory_of(t) is not None]
    assert moving
    for one in moving:
        assert one.rotation_mode == "QUATERNION" and not keys_of(one)
        above = trajectory_of(one)
        assert above is not None and above.rotation_mode == "QUATERNION" and keys_of(above)


def test_a_second_import_doubles_nothing(street: Any) -> None:
    names = {t.name for t in bpy.data.objects}
    meshes, actions = len(bpy.data.meshes), len(bpy.data.actions)
    bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json"))
    assert {t.name for t in bpy.data.objects} == names
    assert (len(bpy.data.meshes), len(bpy.data.actions)) == (meshes, actions)


def test_an_import_alone_is_no_edit(street: Any) -> None:
    scenario = read(street)
    assert scenario.edits == ()
    assert scenario.sensors is None
    assert scenario.boxes is None


def test_a_saved_file_is_the_same_scenario(street: Any, tmp_path: Path) -> None:
    imported(street, "ACTOR", sorted(source_of(street).drive.actors)[0]).location.x += 3.0
    before = read(street)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "street.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "street.blend"))
    assert read(bpy.context.scene) == before


def test_colours_are_as_recorded(street: Any) -> None:
    view = street.view_settings
    assert (view.view_transform, view.look, view.exposure, view.gamma) == ("Standard", "None", 0.0, 1.0)


def test_what_is_no_scene_is_one_sentence(scene: Any, tmp_path: Path) -> None:
    path = tmp_path / "scene.json"
    path.write_text("{}")
    with pytest.raises(RuntimeError, match=str(path)):
        bpy.ops.unisim.import_scene(filepath=str(path))
    assert not scene.objects


def test_a_drop_that_fails_is_one_sentence(scene: Any, tmp_path: Path) -> None:
    for name in ("scene.json", "scenario.json"):
        path = tmp_path / name
        path.write_text("{}")
        with pytest.raises(RuntimeError, match=f"^Error: {path}: [^\n]*\n?$"):
            bpy.ops.unisim.import_drive("INVOKE_DEFAULT", filepath=str(path))
    unknown = tmp_path / "elsewhere" / "unknown.gz"
    unknown.parent.mkdir()
    unknown.write_bytes(b"\x1f\x8b\xff\x00")
    with pytest.raises(RuntimeError, match=f"^Error: {unknown}: [^\n]*\n?$"):
        bpy.ops.unisim.import_drive("INVOKE_DEFAULT", filepath=str(unknown))
    assert not scene.objects


def test_appended_from_a_file_all_is_there(street: Any, tmp_path: Path) -> None:
    car = imported(street, "ACTOR", "car-12")
    car.location.y += 1.0
    name = street.name
    before = {
        (t.unisim.kind, t.unisim.uid, t.unisim.home)
        for t in imported_objects(street, "EGO", "ACTOR", "CAMERA", "LIDAR")
    }
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "street.blend"))
    bpy.ops.wm.read_factory_settings(use_empty=True)
    held = set(bpy.data.scenes.keys())
    bpy.ops.wm.append(directory=str(tmp_path / "street.blend" / "Scene"), filename=name)
    (new,) = (scene for scene in bpy.data.scenes if scene.name not in held)
    assert {
        (t.unisim.kind, t.unisim.uid, t.unisim.home) for t in imported_objects(new, "EGO", "ACTOR", "CAMERA", "LIDAR")
    } == before
    moved = imported(new, "ACTOR", "car-12")
    assert moved.location.y == pytest.approx(car_y(source_of(new), "car-12") + 1.0, abs=1e-4)


def car_y(source: Any, uid: str) -> float:
    """Where a standing car was recorded."""
    return float(source.drive.actors[uid].world_from_actor.positions[0, 1])


def test_a_scene_with_the_settings_alone_holds_no_drive(street: Any) -> None:
    """As New Scene > Copy Settings makes it: nothing is read as removed, and the drive can be imported."""
    other = bpy.data.scenes.new("copy")
    other.unisim.log, other.unisim.scene = street.unisim.log, street.unisim.scene
    with pytest.raises(UnisimError, match="no drive was imported into it"):
        read(other)
    for _ in import_source(other, open_source(street.unisim.log, street.unisim.scene)):
        pass
    assert len(list(imported_objects(other, "ACTOR"))) == len(list(imported_objects(street, "ACTOR"))) > 0
    assert source_of(other) is source_of(street)


def test_a_scenario_beside_rendered_frames_is_no_log(scene: Any, tmp_path: Path) -> None:
    for folder in ("camera", "lidar"):
        (tmp_path / folder).mkdir()
    text = (SAMPLE / "scenario.json").read_text().replace('"scene": "scene"', f'"scene": "{SAMPLE / "scene"}"')
    (tmp_path / "scenario.json").write_text(text)
    assert bpy.ops.unisim.import_drive(filepath=str(tmp_path / "scenario.json")) == {"FINISHED"}
    assert Path(scene.unisim.scene) == SAMPLE / "scene" and read(scene).edits


def test_an_import_into_blenders_default_scene_is_ready_to_be_looked_at(addon: Any) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=False)
    scene = bpy.context.scene
    assert {"Camera", "Cube", "Light"} <= {o.name for o in scene.objects}
    bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json"))
    assert scene.camera.unisim.uid == "front_camera" and scene.render.engine == "UNISIM"
    model = source_of(scene).drive.cameras["front_camera"].model
    assert (scene.render.resolution_x, scene.render.resolution_y) == (model.width, model.height)
    shown = {o.name for o in bpy.context.view_layer.objects}
    assert not shown & {"Camera", "Cube", "Light"} and {"Camera", "Cube", "Light"} <= {o.name for o in bpy.data.objects}


def test_what_a_person_made_before_stays_in_view(addon: Any) -> None:
    bpy.ops.wm.read_factory_settings(use_empty=False)
    bpy.data.objects["Cube"].location.x = 3.0
    bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json"))
    assert "Cube" in bpy.context.view_layer.objects and "Light" not in bpy.context.view_layer.objects


def test_an_import_says_in_one_line_what_came_in(street: Any) -> None:
    line = summary(source_of(street))
    drive = source_of(street).drive
    assert f"{len(drive.actors)} actors" in line and f"{len(drive.time_s)} frames" in line and "\n" not in line


def test_a_second_import_leaves_camera_and_engine(street: Any) -> None:
    street.render.engine = "CYCLES"
    other = bpy.data.objects.new("mine", bpy.data.cameras.new("mine"))
    street.collection.objects.link(other)
    street.camera = other
    bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json"))
    assert street.camera == other and street.render.engine == "CYCLES"
