"""Operators that add objects to the drive, or run long work."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import bpy
import numpy as np
import pytest
from helpers import SAMPLE, drawn, edited, imported, read, select
from PIL import Image

from unisim_blender.bridge.importing.drive import recorded_colours
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.bridge.window import choose
from unisim_blender.core.scenario.edits import Insert, Move, Swap
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.scene import same
from unisim_blender.process.background import newest, running
from unisim_blender.process.tasks import SequenceTask


def of_class(scene: Any, word: str, moving: bool) -> str:
    """The id of the first actor of a class that moves, or stands."""
    actors = source_of(scene).drive.actors
    return next(uid for uid, actor in sorted(actors.items()) if word in actor.label and actor.is_moving == moving)


def test_replacing_a_look_keeps_the_ground(street: Any) -> None:
    car, cone = of_class(street, "Car", False), of_class(street, "Cone", False)
    select(imported(street, "ACTOR", car))
    assert bpy.ops.unisim.replace_appearance(appearance=cone) == {"FINISHED"}
    assert read(street).edits == (Swap(car, cone),)
    actor, recorded = edited(street).actors[car], source_of(street).drive.actors[car]

    def under(one: Any) -> float:
        return float(one.world_from_actor.positions[0, 2] - one.size_m[2] / 2)

    assert under(actor) == pytest.approx(under(recorded), abs=1e-4)
    assert bpy.ops.unisim.replace_appearance(appearance=car) == {"FINISHED"}
    assert read(street).edits == ()


def test_inserting_from_another_scene(street: Any) -> None:
    street.cursor.location = (25.0, 3.0, 0.0)
    uid = of_class(street, "Car", False)
    assert bpy.ops.unisim.insert_actor(filepath=str(SAMPLE / "scene" / "scene.json"), actor=uid, where="CURSOR") == {
        "FINISHED"
    }
    (edit,) = read(street).edits
    assert isinstance(edit, Insert) and edit.actor == uid and edit.pose is not None
    actor = edited(street).actors[edit.id]
    assert actor.world_from_actor.positions[0] == pytest.approx([25.0, 3.0, actor.size_m[2] / 2], abs=1e-4)


@pytest.mark.parametrize(
    ("cursor", "forward"),
    [
        ((0.0, 0.0, 0.0), None),
        ((1.1, 0.0, 0.8), None),  # as a click in a slanted view leaves it
        ((0.0, 0.0, 2.0), (np.cos(2.0), np.sin(2.0), 0.0)),
    ],
)
def test_an_actor_at_the_cursor_faces_along_the_nearest_path(street: Any, cursor: Any, forward: Any) -> None:
    driving = next(one for one in edited(street).actors.values() if one.is_moving and one.label == "Car")
    pose = driving.world_from_actor.at(np.array([0.5]))[0]
    street.cursor.location, street.cursor.rotation_mode = pose[:3, 3], "XYZ"
    street.cursor.rotation_euler = cursor
    assert bpy.ops.unisim.insert_actor(actor=of_class(street, "Car", False), where="CURSOR") == {"FINISHED"}
    axis = np.array(bpy.context.active_object.matrix_world)[:3, 0]
    assert axis == pytest.approx(pose[:3, 0] if forward is None else forward, abs=0.02)


def test_no_operator_remembers_what_it_was_last_done_to(street: Any) -> None:
    """A button without a file, a folder or a name is for the drive, and not for what another button named."""
    for name in dir(bpy.ops.unisim):
        properties = getattr(bpy.ops.unisim, name).get_rna_type().properties
        for prop in () if "filter_glob" in properties else properties:  # a file browser opens where it was
            if prop.type == "STRING" and prop.is_hidden:
                assert prop.is_skip_save, f"{name}.{prop.identifier}"
    rna = bpy.ops.unisim.replace_appearance.get_rna_type()
    assert rna.properties["scene"].is_skip_save


def test_other_scenes_are_offered_where_their_actors_can_be_shown(street: Any) -> None:
    assert bpy.ops.unisim.insert_from.poll()
    street.unisim.scene = ""
    assert not bpy.ops.unisim.insert_from.poll()


@pytest.mark.parametrize("frame", [0, 19])
@pytest.mark.parametrize("word", ["Car", "Cone"])
def test_an_inserted_actor_is_in_front_of_the_ego_on_its_path(street: Any, word: str, frame: int) -> None:
    """Whatever the frame, Check has nothing against it, and it meets neither the ego nor another actor."""
    street.frame_set(frame)
    uid = next(uid for uid, actor in sorted(source_of(street).drive.actors.items()) if word in actor.label)
    assert bpy.ops.unisim.insert_actor(actor=uid) == {"FINISHED"}
    obj, drive = bpy.context.active_object, source_of(street).drive
    edit: Any
    (edit,) = read(street).edits
    new = edited(street).actors[edit.id].world_from_actor
    ego = drive.world_from_ego.at(drive.time_s[frame])
    ahead, left, _ = (np.linalg.inv(ego) @ new.at(drive.time_s[frame]))[:3, 3]
    assert 8.0 < ahead < 60.0 and abs(left) < 6.5
    times = np.array(list(drive.time_s.values()))
    apart = np.linalg.norm(new.at(times)[:, :2, 3] - drive.world_from_ego.at(times)[:, :2, 3], axis=1)
    assert apart.min() > 1.5
    assert bpy.ops.unisim.check() == {"FINISHED"}
    assert [(one.name, one.text) for one in street.unisim_check.warnings] == []
    if word == "Car":
        assert abs(left) < 1.0 and np.ptp(apart) < 1.0, "at the ego's speed"
        assert obj.parent is not None


@pytest.mark.parametrize("fps", [10, 30])
def test_following_a_curve_at_a_speed(street: Any, fps: int) -> None:
    street.render.fps, street.render.fps_base = fps, 1.0
    line = drawn(street, [(10, 0, 0), (30, 0, 0), (30, 20, 0)])
    uid = of_class(street, "Car", False)
    one = imported(street, "ACTOR", uid)
    select(line, one)
    street.frame_set(2)
    assert bpy.ops.unisim.follow_curve(speed_m_s=10.0) == {"FINISHED"}
    clock = Clock.of(source_of(street).drive)
    (now,) = [t for t in sample_all(street, clock).of("ACTOR") if t.uid == uid]
    speed = np.linalg.norm(np.diff(now.poses[:, :3, 3], axis=0), axis=1) / np.diff(clock.times_s)
    assert np.median(speed[3:12]) == pytest.approx(10.0, rel=0.02)
    assert now.poses[5, :3, 0] == pytest.approx([1, 0, 0], abs=1e-3)
    assert now.poses[5, 2, 3] == pytest.approx(now.size_m[2] / 2, abs=1e-3)
    (edit,) = read(street).edits
    assert isinstance(edit, Move) and edit.trajectory is not None


def test_snapping_to_the_ground(street: Any) -> None:
    uid = of_class(street, "Car", False)
    one = imported(street, "ACTOR", uid)
    before = one.location.z
    one.location.z += 3.0
    bpy.context.view_layer.update()
    select(one)
    assert bpy.ops.unisim.snap_to_ground() == {"FINISHED"}
    assert one.location.z == pytest.approx(before, abs=0.15)


def test_new_sensors_are_read_and_render(street: Any) -> None:
    assert bpy.ops.unisim.add_camera(width=96, height=54, fov_deg=90.0, yaw_deg=20.0) == {"FINISHED"}
    assert (street.render.resolution_x, street.render.resolution_y) == (96, 54)
    assert bpy.ops.unisim.add_lidar(preset="vlp32c") == {"FINISHED"}
    drive = edited(street)
    camera, lidar = drive.cameras["camera"], drive.lidars["vlp32c"]
    assert camera.model.fx == pytest.approx(48.0, abs=1e-3) and lidar.model.beams == 32
    time = drive.time_s[5]
    ahead = np.linalg.inv(drive.world_from_ego.at(time)[:3, :3]) @ camera.world_from_camera.at(time)[:3, 2]
    assert np.degrees(np.arctan2(ahead[1], ahead[0])) == pytest.approx(20.0, abs=0.01)


def test_a_lidar_with_beams_of_ones_own(street: Any) -> None:
    assert bpy.ops.unisim.add_lidar(preset="OWN", elevations="-4, 2,0", columns=360, max_range_m=80.0) == {"FINISHED"}
    model = edited(street).lidars["lidar"].model
    np.testing.assert_allclose(np.degrees(model.elevation_rad), [2, 0, -4], atol=1e-9)
    assert (model.columns, model.max_range_m) == (360, 80.0)
    for wrong in ("", "a, b", "95"):
        with pytest.raises(RuntimeError, match="elevations"):
            bpy.ops.unisim.add_lidar(preset="OWN", elevations=wrong)
    select(imported(street, "LIDAR", "pandar64"))
    assert bpy.ops.unisim.set_beams(preset="vlp32c") == {"FINISHED"}
    changed, before = edited(street).lidars["pandar64"], source_of(street).drive.lidars["pandar64"]
    assert changed.model.beams == 32 and before.model.beams == 64
    time = before.time_s[5]
    assert same(changed.world_from_lidar.at(time), before.world_from_lidar.at(time))


def test_colours_as_they_were_recorded(street: Any) -> None:
    view = street.view_settings
    view.view_transform, view.exposure, view.gamma = "Filmic" if "Filmic" in look_names(view) else "AgX", 1.0, 2.0
    assert not recorded_colours(street)
    assert bpy.ops.unisim.recorded_colours() == {"FINISHED"}
    assert recorded_colours(street) and view.exposure == 0.0 and view.gamma == 1.0


def look_names(view: Any) -> list[str]:
    """The view transforms that there are."""
    return [item.identifier for item in view.bl_rna.properties["view_transform"].enum_items]


def test_what_runs_is_cancelled(street: Any, tmp_path: Path) -> None:
    assert not bpy.ops.unisim.cancel_task.poll()
    task = SequenceTask([], tmp_path, 3.0)
    task.process = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(600)"])
    running.append(task)
    assert bpy.ops.unisim.cancel_task() == {"FINISHED"}
    assert task.process.wait(30) != 0 and task.cancelled
    running.clear()


def test_resolution_follows_the_active_camera_and_nothing_else(street: Any) -> None:
    first, render = street.camera, street.render
    size = render.resolution_x, render.resolution_y
    assert bpy.ops.unisim.add_camera(width=96, height=54) == {"FINISHED"}
    bpy.context.view_layer.update()
    street.camera = first
    bpy.context.view_layer.update()
    assert (render.resolution_x, render.resolution_y) == size
    render.resolution_x, first.location.x = 123, first.location.x + 1
    bpy.context.view_layer.update()
    assert render.resolution_x == 123


def test_a_sequence_is_resumed_and_gives_the_commands_bytes(street: Any, tmp_path: Path) -> None:
    street.frame_start, street.frame_end = 4, 6
    street.unisim.out = str(tmp_path / "out")
    for other in [o for o in imported_objects(street, "LIDAR")]:
        bpy.data.objects.remove(other)
    bpy.ops.unisim.add_camera(width=64, height=36)
    bpy.data.objects.remove(next(o for o in imported_objects(street, "CAMERA") if o.unisim.uid != "camera"))
    assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
    images = sorted((tmp_path / "out" / "camera" / "camera").glob("*.png"))
    assert [path.stem for path in images] == ["000004", "000005", "000006"]
    stamp, first = os.stat(images[0]).st_mtime_ns, images[0].read_bytes()
    images[1].unlink()
    assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
    assert images[1].is_file() and os.stat(images[0]).st_mtime_ns == stamp and images[0].read_bytes() == first
    assert "3 of 3 frames" in newest[SequenceTask].line


def test_a_sequence_of_some_sensors_at_a_width(street: Any, tmp_path: Path) -> None:
    street.frame_start = street.frame_end = 5
    street.unisim.out, street.unisim.sequence_width = str(tmp_path / "out"), 48
    street.unisim.sequence_sensors = "CAMERA"
    assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
    with Image.open(tmp_path / "out" / "camera" / street.camera.unisim.uid / "000005.png") as image:
        assert image.width == 48
    assert not (tmp_path / "out" / "lidar").exists()
    street.unisim.sequence_sensors = "SELECTED"
    choose(bpy.context, street.camera.parent)
    with pytest.raises(RuntimeError, match="Output > Sensors: no camera or LiDAR is selected"):
        bpy.ops.unisim.render_sequence()
    lidar = next(imported_objects(street, "LIDAR"))
    street.unisim.out = str(tmp_path / "sweeps")
    choose(bpy.context, lidar)
    assert bpy.ops.unisim.render_sequence() == {"FINISHED"}
    assert (tmp_path / "sweeps" / "lidar" / lidar.unisim.uid / "000005.ply").is_file()
    assert not (tmp_path / "sweeps" / "camera").exists()


def test_a_sequence_that_fails_says_why(street: Any, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file")
    street.unisim.out = str(tmp_path / "out")
    with pytest.raises(RuntimeError, match="out"):
        bpy.ops.unisim.render_sequence()


def test_a_folder_beside_a_file_that_was_never_saved(street: Any) -> None:
    with pytest.raises(RuntimeError, match="//render: save the .blend first"):
        bpy.ops.unisim.render_sequence()


def test_the_renderer_is_found_and_described(street: Any) -> None:
    bpy.ops.unisim.test_renderer()
    assert "torch" in bpy.context.window_manager.unisim_renderer
