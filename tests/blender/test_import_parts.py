"""Parts of a drive that are imported, what a chosen path leads to, and the first steps after it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import pytest
from helpers import read

from unisim_blender.bridge.objects.imported import imported_objects, skipped_sensors, source_of
from unisim_blender.bridge.sampling.edit_list import read_now
from unisim_blender.core.scenario.sensors.document import Sensors
from unisim_blender.core.scenario.types import FrameRange
from unisim_blender.features.drive.export_operators import scenario_of


def names(scene: Any) -> list[str]:
    """The imported sensors."""
    return [obj.unisim.uid for obj in imported_objects(scene, "CAMERA", "LIDAR")]


def test_sensors_that_are_not_imported_are_neither_edits_nor_rendered(scene: Any, street_log: Path) -> None:
    assert bpy.ops.unisim.import_drive(filepath=str(street_log), sensors=" front_c*,") == {"FINISHED"}
    assert names(scene) == ["front_camera"] and skipped_sensors(scene) == {"pandar64"}
    assert read_now(scene) == ()
    assert read(scene).sensors == Sensors(cameras=None, lidars=())
    # a sensor that was imported and is deleted is an edit, as ever
    bpy.data.objects.remove(next(imported_objects(scene, "CAMERA")))
    assert [(line.part, line.uid) for line in read_now(scene)] == [("REMOVE", "front_camera")]


def test_an_import_again_adds_and_takes_away(scene: Any, street_log: Path) -> None:
    path = str(street_log)
    assert bpy.ops.unisim.import_log(filepath=path, sensors="front_camera") == {"FINISHED"}
    assert bpy.ops.unisim.import_log(filepath=path) == {"FINISHED"}  # as it was chosen
    assert names(scene) == ["front_camera"]
    assert bpy.ops.unisim.import_log(filepath=path, sensors="*") == {"FINISHED"}
    assert names(scene) == ["front_camera", "pandar64"] and read(scene).sensors is None
    bpy.context.view_layer.update()
    next(imported_objects(scene, "CAMERA")).location.z += 0.5
    assert bpy.ops.unisim.import_log(filepath=path, sensors="pandar64") == {"FINISHED"}
    assert names(scene) == ["front_camera", "pandar64"]  # an edit stays
    assert bpy.ops.unisim.import_log(filepath=path, sensors="front_camera") == {"FINISHED"}
    assert names(scene) == ["front_camera"]
    assert [(line.part, line.uid) for line in read_now(scene)] == [("SENSOR", "front_camera")]


def test_restored_sensors_are_imported(scene: Any, street_log: Path) -> None:
    assert bpy.ops.unisim.import_log(filepath=str(street_log), sensors="front_camera") == {"FINISHED"}
    assert bpy.ops.unisim.restore_sensors() == {"FINISHED"}
    assert not skipped_sensors(scene) and read(scene).sensors is None and read_now(scene) == ()


def test_frames_reach_the_scenario_and_stay(scene: Any, street_log: Path) -> None:
    parts = {"all_frames": False, "first_frame": 1, "last_frame": 99, "frame_step": 1}
    assert bpy.ops.unisim.import_drive(filepath=str(street_log), **parts) == {"FINISHED"}
    last = max(source_of(scene).drive.time_s)
    assert (scene.frame_start, scene.frame_end, scene.frame_step) == (1, last, 1)
    assert scenario_of(scene, Path("s.json")).frames == FrameRange(1, last + 1, 1) and read_now(scene) == ()
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    assert scene.frame_start == 1


@pytest.mark.parametrize(
    ("parts", "fault"),
    [
        ({"sensors": "front_camera, other*"}, r'sensors: "other\*" is none of .*front_camera'),
        ({"all_frames": False, "first_frame": 90, "last_frame": 99}, "frames 90 to 99: the drive has frames 0 to"),
    ],
)
def test_what_a_drive_does_not_have_is_one_sentence(
    scene: Any, street_log: Path, parts: dict[str, Any], fault: str
) -> None:
    with pytest.raises(RuntimeError, match=f"^Error: {fault}"):
        bpy.ops.unisim.import_log(filepath=str(street_log), **parts)
    assert not scene.objects and not scene.unisim.log


def test_a_folder_with_several_names_them(scene: Any, street_log: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        (tmp_path / name).symlink_to(street_log)
    with pytest.raises(RuntimeError, match=f"^Error: {tmp_path}: holds several; choose one: a, b"):
        bpy.ops.unisim.import_drive(filepath=str(tmp_path))
    (tmp_path / "b").unlink()
    assert bpy.ops.unisim.import_drive(directory=str(tmp_path)) == {"FINISHED"}
    assert source_of(scene).log_path == tmp_path / "a"


def test_first_steps_belong_to_a_files_first_drive(scene: Any, street_log: Path) -> None:
    panel = bpy.types.UNISIM_PT_first_steps
    assert panel.poll(bpy.context)
    assert bpy.ops.unisim.import_drive(filepath=str(street_log)) == {"FINISHED"}
    assert scene.unisim.first_steps and panel.poll(bpy.context)
    scene.unisim.first_steps = False
    assert not panel.poll(bpy.context)
    bpy.context.window.scene = other = bpy.data.scenes.new("other")
    assert bpy.ops.unisim.import_drive(filepath=str(street_log)) == {"FINISHED"}
    assert other.unisim.log and not other.unisim.first_steps and not panel.poll(bpy.context)


def test_the_dialog_has_a_switch_for_each_sensor(scene: Any, street_log: Path) -> None:
    assert bpy.ops.unisim.import_log(filepath=str(street_log), sensors="pandar64") == {"FINISHED"}
    assert bpy.ops.unisim.import_sensors(sensors={"front_camera"}) == {"FINISHED"}
    assert names(scene) == ["front_camera"] and read_now(scene) == ()
    with pytest.raises(RuntimeError, match='sensors: "" is none of front_camera, pandar64'):
        bpy.ops.unisim.import_sensors(sensors=set())
