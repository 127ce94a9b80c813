"""The procedural street through lenses that bend lines equals the pinhole's image, resampled, where both see."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.lenses.lens import Lens
from unisim_blender.core.lenses.mei import Mei
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole
from unisim_blender.core.sensors.camera import pixel_directions, pixel_grid
from unisim_blender.core.sensors.frames import CameraFrame
from unisim_blender.core.sensors.unprojection import has_direction
from unisim_blender.core.world.drive import CameraModel, Drive
from unisim_street.street import Street, build_street
from unisim_street.truth import truth_camera

CAMERA, FRAME = "front_camera", 3
SEEN_BY: dict[str, tuple[Lens, float]] = {
    "fisheye": (OpenCVFisheye(k1=-0.02), 70.0),
    "strong distortion": (OpenCVPinhole(k1=-0.25, k2=0.05, p1=0.002), 110.0),
    "mei": (Mei(1.6, -0.05), 180.0),
}


@pytest.fixture(scope="module")
def street() -> Street:
    return build_street(seed=3, frames=6, width=160, height=90)


def through(drive: Drive, model: CameraModel) -> Drive:
    return replace(drive, cameras={CAMERA: replace(drive.cameras[CAMERA], model=model)})


@pytest.fixture(scope="module")
def pinhole(street: Street) -> tuple[CameraModel, CameraFrame]:
    model = CameraModel(480, 320, 240.0, 240.0, 240.0, 160.0)
    return model, truth_camera(street, through(street.drive, model), CAMERA, FRAME)


@pytest.mark.parametrize("name", SEEN_BY)
def test_truth_through_a_lens_is_the_pinholes_resampled(
    street: Street, pinhole: tuple[CameraModel, CameraFrame], name: str
) -> None:
    lens, focal = SEEN_BY[name]
    model = CameraModel(160, 120, focal, focal, 80.0, 60.0, lens=lens)
    frame = truth_camera(street, through(street.drive, model), CAMERA, FRAME)
    u, v = pixel_grid(model)
    shown = has_direction(model, u, v)
    at_u, at_v, ahead = pinhole[0].project(pixel_directions(model, u, v))
    both = shown & ahead & (at_u > 2) & (at_u < 478) & (at_v > 2) & (at_v < 318)
    assert both.sum() > 4000
    wanted, depth = pinhole[1].rgb[at_v[both].astype(int), at_u[both].astype(int)], pinhole[1].depth_m
    assert depth is not None and frame.depth_m is not None and frame.instance is not None
    # edges differ by a pixel's footprint: nearly all of the rest is the same
    assert np.abs(frame.rgb[both] - wanted).max(1).mean() < 0.06
    assert np.median(np.abs(frame.rgb[both] - wanted).max(1)) < 0.02
    there: FloatArray = depth[at_v[both].astype(int), at_u[both].astype(int)]
    mine = frame.depth_m[both]
    finite = np.isfinite(there) & np.isfinite(mine)
    # a pixel of the pinhole is not the same ray: on the ground its depth differs by its footprint
    assert np.median(np.abs(mine - there)[finite] / there[finite]) < 0.02
    assert (np.isfinite(there) == np.isfinite(mine)).mean() > 0.97
    # a wrong lens is far off
    wrong = pinhole[1].rgb[np.clip(at_v[both] + 12, 0, 319).astype(int), at_u[both].astype(int)]
    assert np.abs(frame.rgb[both] - wrong).max(1).mean() > 1.5 * np.abs(frame.rgb[both] - wanted).max(1).mean()


def test_what_the_lens_does_not_show_is_black_and_empty(street: Street) -> None:
    model = CameraModel(96, 96, 25.0, 25.0, 48.0, 48.0, lens=OpenCVFisheye(max_angle_deg=100))
    frame = truth_camera(street, through(street.drive, model), CAMERA, FRAME)
    shown = has_direction(model, *pixel_grid(model))
    assert 0.5 < shown.mean() < 0.8 and not shown[0, 0]
    assert frame.depth_m is not None and frame.instance is not None and frame.opacity is not None
    assert (frame.rgb[~shown] == 0).all() and frame.rgb[shown].min(0).max() > 0
    assert (
        np.isinf(frame.depth_m[~shown]).all()
        and (frame.instance[~shown] == 0).all()
        and (frame.opacity[~shown] == 0).all()
    )
    # a point behind the camera's plane is in the image: the rays there look back
    back = pixel_directions(model, *pixel_grid(model))[..., 2] < 0
    assert (back & shown).sum() > 100 and np.isfinite(frame.depth_m[back & shown]).any()
