"""What boxes cover of an image holds all pixels whose rays hit them, behind the camera's plane and through it, too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from unisim_blender.core.geometry import intersect_boxes, invert_pose, make_pose
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.sensors.camera import pixel_directions, pixel_grid
from unisim_blender.core.sensors.silhouettes import covered
from unisim_blender.core.sensors.unprojection import has_direction
from unisim_blender.core.world.drive import CameraModel

MODEL = CameraModel(48, 32, 24.0, 24.0, 24.0, 16.0)
BENT = CameraModel(48, 32, 13.0, 13.0, 24.0, 16.0, lens=OpenCVFisheye(k1=-0.02, max_angle_deg=105))


@pytest.mark.parametrize("model", [MODEL, BENT], ids=["pinhole", "fisheye"])
@settings(max_examples=120, deadline=None)
@given(seed=st.integers(0, 2**31))
def test_every_pixel_that_hits_a_box_is_covered(model: CameraModel, seed: int) -> None:
    rng = np.random.default_rng(seed)
    quaternions = rng.normal(size=(2, 4))
    poses = make_pose(rng.uniform(-6, 6, (2, 3)), quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True))
    size = rng.uniform(0.3, 6, 3)
    directions = pixel_directions(model, *pixel_grid(model)).reshape(-1, 3)
    enter, leave = intersect_boxes(np.zeros_like(directions), directions, invert_pose(poses), np.tile(size, (2, 1)))
    shown = has_direction(model, *pixel_grid(model))
    hit = ((enter <= leave) & (leave > 0.1)).any(1).reshape(model.height, model.width) & shown
    part = covered(model, poses, size)
    rows, columns = np.nonzero(hit)
    if part is None:
        assert not len(rows)
        return
    if len(rows):
        assert part.left <= columns.min() + 0.5 and part.right >= columns.max() + 0.5
        assert part.top <= rows.min() + 0.5 and part.bottom >= rows.max() + 0.5


def test_a_box_ahead_is_covered_tightly() -> None:
    pose = make_pose(np.array([[0.0, 0.0, 10.0]]), np.array([[1.0, 0, 0, 0]]))
    part = covered(MODEL, pose, np.array([2.0, 1.0, 2.0]))
    assert part is not None
    np.testing.assert_allclose(part, (24 - 24 / 9, 16 - 12 / 9, 24 + 24 / 9, 16 + 12 / 9))
    assert covered(MODEL, pose * np.array([1, 1, -1, 1.0])[:, None], np.array([2.0, 1.0, 2.0])) is None
