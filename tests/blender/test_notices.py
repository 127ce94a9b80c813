"""What a view says it cannot show."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import copytree
from typing import Any

import bpy
import numpy as np

from unisim_blender.bridge.importing.backgrounds import sees_recorded_image
from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.objects.sensors import camera_model_of
from unisim_blender.core.geometry import box_corners, invert_pose, transform_points
from unisim_blender.viewport.notice_text import notices
from unisim_blender.viewport.overlays import outlines


def said(scene: Any, through: bool = True) -> list[str]:
    """What is said in the scene as it is."""
    bpy.context.view_layer.update()
    return notices(scene, source_of(scene), scene.camera if through else None)


def test_what_was_not_recorded_is_said(scene: Any, street_log: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    copytree(street_log, log)
    next((log / "camera" / "front_camera").glob("*1.*")).unlink()
    (log / "lidar" / "01.pkl.gz").unlink()
    assert bpy.ops.unisim.import_log(filepath=str(log)) == {"FINISHED"}
    scene.frame_set(0)
    assert said(scene) == []
    bpy.ops.unisim.show_points(recorded=True, simulated=False)
    assert said(scene) == []
    scene.frame_set(1)
    lidars = ", ".join(sorted(source_of(scene).drive.lidars))
    assert said(scene) == [f"Frame 1: {scene.camera.name} recorded no image", f"Frame 1: {lidars} recorded no sweep"]
    assert said(scene, through=False) == [f"Frame 1: {lidars} recorded no sweep"]
    scene.frame_set(7)
    assert len(said(scene)) == 1 and "outside the drive" in said(scene)[0]


def test_a_moved_camera_says_that_its_image_is_not_shown(scene: Any, street_log: Path) -> None:
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    bpy.ops.unisim.shift_ego(left_m=1.0)
    assert said(scene) == [f"{scene.camera.name} was moved: its recorded image is not shown"]


def test_a_lens_that_bends_lines_says_what_follows_it(scene: Any, street_log: Path, tmp_path: Path) -> None:
    log = tmp_path / "log"
    copytree(street_log, log)
    setup = json.loads((log / "meta" / "unisim.json").read_text())
    for camera in setup["cameras"].values():
        camera["lens"] = {"type": "opencv_fisheye", "k1": -0.02}
    (log / "meta" / "unisim.json").write_text(json.dumps(setup))
    assert bpy.ops.unisim.import_log(filepath=str(log)) == {"FINISHED"}
    assert said(scene) == [
        f"The lens of {scene.camera.name} bends lines: outlines and images follow it, Blender's own boxes do not"
    ]
    drive = source_of(scene).drive
    assert sees_recorded_image(scene, scene.camera, drive)
    found = outlines(scene, bpy.context.view_layer)
    pose = drive.cameras[scene.camera.unisim.uid].world_from_camera.at(drive.cameras[scene.camera.unisim.uid].time_s[0])
    seen = 0
    for obj in imported_objects(scene, "ACTOR"):
        actor = drive.actors[obj.unisim.uid]
        corners = box_corners(actor.world_from_actor.at(drive.time_s[0]), actor.size_m)
        u, v, valid = camera_model_of(scene.camera).project(transform_points(invert_pose(pose), corners))
        inside = valid & (u > 0) & (u < 96) & (v > 0) & (v < 54)
        if obj.visible_get() and inside.all():
            ends = np.concatenate([segments.reshape(-1, 2) for segments, _ in found])
            for corner in np.stack([u, v], -1):
                assert np.abs(ends - corner).max(-1).min() < 0.02
            seen += 1
    assert seen > 0


def test_without_the_ego_vehicle_it_is_said_that_it_was_deleted(scene: Any, street_log: Path) -> None:
    assert bpy.ops.unisim.import_log(filepath=str(street_log)) == {"FINISHED"}
    bpy.data.objects.remove(next(one for one in scene.objects if one.unisim.kind == "EGO"))
    camera = scene.camera.name
    assert said(scene) == [f"The ego vehicle was deleted: the recorded image of {camera} is not shown"]


def test_a_log_that_is_gone_is_said(street: Any) -> None:
    street.unisim.show_recorded = True
    source = source_of(street)
    expected = (
        []
        if source.log is not None
        else [f"{source.log_path.name}: the log is not at hand, so no recorded points are shown"]
    )
    assert said(street, through=False) == expected
