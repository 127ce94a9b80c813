"""What would silently mean something else is refused, or said."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest
from helpers import SAMPLE, read, thing
from mathutils import Quaternion

from unisim_blender.bridge.objects.imported import imported_objects
from unisim_blender.bridge.objects.source import source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.errors import ScenarioError
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock
from unisim_blender.editing.sampled.outside import outside_drive


def test_a_deleted_vehicle_is_refused_and_comes_back_with_its_sensors(street: Any) -> None:
    bpy.data.objects.remove(next(imported_objects(street, "EGO")))
    with pytest.raises(ScenarioError, match="has no ego vehicle"):
        read(street)
    bpy.ops.unisim.import_scene(filepath=str(SAMPLE / "scene" / "scene.json"))
    scenario = read(street)
    assert not scenario.edits and scenario.sensors is None


def test_frames_outside_the_drive_are_marked(street: Any) -> None:
    drive = source_of(street).drive
    assert not outside_drive(0.0, drive) and not outside_drive(float(drive.frames[-1]), drive)
    assert "outside the drive" in outside_drive(-1.0, drive)
    assert f"frames {drive.frames[0]} to {drive.frames[-1]}" in outside_drive(drive.frames[-1] + 0.5, drive)


def test_a_camera_that_looks_where_none_did_is_found(street: Any) -> None:
    drive = source_of(street).drive
    camera = thing(street, "CAMERA", "front_camera")
    before = [found.text for found in warnings_of(sample_all(street, Clock.of(drive)), drive) if found.name == camera.name]
    assert not before
    turn = Quaternion((0.0, 0.0, 1.0), np.pi / 2)
    camera.rotation_quaternion = turn @ camera.rotation_quaternion
    found = [found.text for found in warnings_of(sample_all(street, Clock.of(drive)), drive) if found.name == camera.name]
    assert any("beside all that was recorded" in text for text in found)
