"""What a 3D view shows and lets people pick."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import bpy
import numpy as np

from unisim_blender.bridge.objects.imported import source_of
from unisim_blender.bridge.objects.sensors import drawn_tiny, frustums_differ, resize_frustums
from unisim_blender.editing.sensors.mounts import recorded_camera_pose
from unisim_blender.viewport.view_types import CAMERAS, EMPTIES, SWITCHES, turned_off, wanted


def view(perspective: str, shading: str) -> Any:
    """A 3D view as far as it matters here."""
    return SimpleNamespace(
        region_3d=SimpleNamespace(view_perspective=perspective), shading=SimpleNamespace(type=shading)
    )


def test_through_a_camera_sensors_are_neither_seen_nor_picked(street: Any) -> None:
    assert {*EMPTIES, "show_object_select_camera"} == wanted(street, view("CAMERA", "SOLID"))


def test_a_rendered_view_shows_no_background_image(street: Any) -> None:
    assert "show_object_viewport_camera" in wanted(street, view("CAMERA", "RENDERED"))
    street.render.engine = "BLENDER_WORKBENCH"
    assert "show_object_viewport_camera" not in wanted(street, view("CAMERA", "RENDERED"))


def test_a_moved_camera_shows_no_image_that_was_recorded_from_elsewhere(street: Any) -> None:
    for frame in (street.frame_start, street.frame_start + 3):
        street.frame_set(frame)
        assert "show_object_viewport_camera" not in wanted(street, view("CAMERA", "SOLID"))
    bpy.ops.unisim.shift_ego(left_m=2.0)
    bpy.context.view_layer.update()
    assert "show_object_viewport_camera" in wanted(street, view("CAMERA", "SOLID"))
    bpy.ops.unisim.shift_ego(left_m=-2.0)
    bpy.context.view_layer.update()
    assert "show_object_viewport_camera" not in wanted(street, view("CAMERA", "SOLID"))
    street.camera.data.lens *= 1.5
    assert "show_object_viewport_camera" in wanted(street, view("CAMERA", "SOLID"))


def test_the_recorded_pose_is_that_of_the_frame_and_drive_asked_for(street: Any) -> None:
    drive, uid = source_of(street).drive, street.camera.unisim.uid
    trajectory = drive.cameras[uid].world_from_camera
    moved = replace(trajectory, positions=trajectory.positions + 1.0)
    other = replace(drive, cameras={**drive.cameras, uid: replace(drive.cameras[uid], world_from_camera=moved)})
    for asked, frame, apart in ((drive, 3, 0.0), (drive, 7, 0.0), (other, 7, 1.0), (drive, 7, 0.0), (drive, 7, 0.0)):
        recorded = trajectory.at(np.array([drive.cameras[uid].time_s[frame]]))[0, :3, 3]
        np.testing.assert_allclose(recorded_camera_pose(asked, uid, float(frame))[:3, 3], recorded + apart, atol=1e-9)


def test_from_outside_all_is_seen_unless_sensors_are_hidden(street: Any) -> None:
    assert not wanted(street, view("PERSP", "RENDERED"))
    street.unisim.show_sensors = False
    assert wanted(street, view("PERSP", "SOLID")) == set(SWITCHES)
    assert wanted(street, view("CAMERA", "SOLID")) == {*EMPTIES, "show_object_select_camera"}


def test_another_camera_shows_all_but_its_background(scene: Any) -> None:
    assert turned_off("OTHER", True, True) == {CAMERAS[0]}
    assert turned_off("RIG", False, True, chosen=True) == {EMPTIES[1], CAMERAS[1]}
    assert turned_off("RIG", True, True, chosen=True) == turned_off("RIG", True, True)
    assert not turned_off("OTHER", False, True)
    assert not wanted(scene, view("CAMERA", "RENDERED"))


def test_frustums_are_tiny_while_a_view_looks_through_a_camera(street: Any) -> None:
    camera = street.camera.data
    camera.display_size = size = 0.25
    assert not drawn_tiny([None]) and drawn_tiny([None, street.camera])
    for _ in range(2):
        resize_frustums(street, True)
        assert camera.display_size < 0.02 and not frustums_differ(street, True) and frustums_differ(street, False)
    for _ in range(2):
        resize_frustums(street, False)
        assert camera.display_size == size and not frustums_differ(street, False)
    assert "unisim_display_size" not in camera
