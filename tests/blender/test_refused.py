"""What would silently mean something else is refused, or said."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
import pytest
from helpers import SAMPLE, imported, read
from mathutils import Quaternion

from unisim_blender.bridge.objects.imported import imported_objects, source_of
from unisim_blender.bridge.sampling.stepping import sample_all
from unisim_blender.core.errors import ScenarioError
from unisim_blender.editing.images.views import BAND_PX, marked_outside, outside_drive, stripes
from unisim_blender.editing.motion.plausibility import warnings_of
from unisim_blender.editing.sampled.clock import Clock


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


def test_an_image_outside_the_drive_is_darker_everywhere_and_striped() -> None:
    image = np.ones((4 * BAND_PX, 6 * BAND_PX, 4), np.float32)
    image[:, :BAND_PX] = 0.0  # transparent
    marked = marked_outside(image)
    assert (marked[..., 3] == image[..., 3]).all() and not marked[:, :BAND_PX].any()
    shown = marked[:, BAND_PX:, 0]
    assert shown.max() < 0.4 and len(np.unique(shown)) == 2
    lighter = shown == shown.max()
    assert 0.4 < lighter.mean() < 0.6
    black = marked_outside(np.concatenate([np.zeros((*image.shape[:2], 3), np.float32), image[..., 3:]], -1))
    assert (black[:, BAND_PX:, 0] > 0.1).mean() > 0.4  # a black image is marked, too
    bands = [marked_outside(image[first : first + 7], first) for first in range(0, len(image), 7)]
    assert np.array_equal(np.concatenate(bands), marked)


def test_stripes_cover_half_of_a_region() -> None:
    corners = stripes(200, 100, 10).reshape(-1, 3, 2)
    (ax, ay), (bx, by) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    # those that begin beside the region lie in it with the part that others lack: half of width + height,
    # times # the # height
    assert np.isclose(np.abs(ax * by - ay * bx).sum() / 2, 300 * 100 / 2)
    assert corners[..., 1].min() == 0 and corners[..., 1].max() == 100


def test_a_camera_that_looks_where_none_did_is_found(street: Any) -> None:
    drive = source_of(street).drive
    camera = imported(street, "CAMERA", "front_camera")
    before = [
        found.text for found in warnings_of(sample_all(street, Clock.of(drive)), drive) if found.name == camera.name
    ]
    assert not before
    turn = Quaternion((0.0, 0.0, 1.0), np.pi / 2)
    camera.rotation_quaternion = turn @ camera.rotation_quaternion
    found = [
        found.text for found in warnings_of(sample_all(street, Clock.of(drive)), drive) if found.name == camera.name
    ]
    assert any("beside all that was recorded" in text for text in found)


def test_check_names_an_actor_that_cannot_be_read(street: Any) -> None:
    """The rest is checked all the same."""
    car = next(imported_objects(street, "ACTOR"))
    car.scale = (-1.0, 1.0, 1.0)
    with pytest.raises(ScenarioError):
        read(street)
    assert bpy.ops.unisim.check() == {"FINISHED"}
    (warning,) = [item for item in street.unisim_check.warnings if item.name == car.name]
    assert "views leave it out, and nothing can be exported or rendered" in warning.text
