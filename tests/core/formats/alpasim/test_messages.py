"""Cameras and poses in AlpaSim's messages: there and back, and what cannot be said is named."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

pytest.importorskip("carla_driver_interface")
from unisim_blender.core.errors import UnisimError  # noqa: E402
from unisim_blender.core.formats.alpasim.endpoints import channel_to, is_loopback  # noqa: E402
from unisim_blender.core.formats.alpasim.messages import (  # noqa: E402  # noqa: E402
    FieldError,
    camera_message,
    model_of,
    pose_message,
    pose_of,
    trajectory_message,
)
from unisim_blender.core.geometry import make_pose, quaternion_from_yaw  # noqa: E402
from unisim_blender.core.lenses import PINHOLE  # noqa: E402
from unisim_blender.core.lenses.f_theta import FTheta  # noqa: E402
from unisim_blender.core.lenses.mei import Mei  # noqa: E402
from unisim_blender.core.lenses.opencv_fisheye import OpenCVFisheye  # noqa: E402
from unisim_blender.core.lenses.opencv_pinhole import OpenCVPinhole  # noqa: E402
from unisim_blender.core.world.drive import CameraModel, RollingShutter  # noqa: E402

LENSES = [
    PINHOLE,
    OpenCVPinhole(k1=-0.1, k2=0.02, p1=0.001, p2=-0.002, s1=0.001),
    OpenCVFisheye(0.02, -0.01, 0.002, -0.0005, 85.0),
    FTheta((1.0, -0.01, -0.03), (), 80.0, (1.01, 0.001, -0.002)),
    FTheta((), (1.0, 0.01, 0.02), 70.0),
]
POINTS = np.array([[0.1, -0.2, 1.0], [0.7, 0.4, 1.0], [-0.5, 0.3, 1.2], [0.0, 0.0, 2.0]])


@pytest.mark.parametrize("lens", LENSES, ids=lambda lens: lens.TYPE)
@pytest.mark.parametrize(("axis", "duration"), [("rows", 0.0), ("rows", 0.02), ("columns", -0.02)])
def test_cameras_there_and_back(lens: Any, axis: str, duration: float) -> None:
    shutter = RollingShutter(duration, 0.5, axis)
    model = CameraModel(640, 360, 320.0, 330.0, 318.5, 181.25, shutter, lens)
    message = camera_message("front", model)
    back, time_us = model_of(message, 640, 360, 90_000, 110_000, "camera_intrinsics")
    assert time_us == 100_000 and back.shutter == (RollingShutter() if duration == 0 else shutter)
    for mine, its in zip(model.project(POINTS), back.project(POINTS), strict=True):
        assert np.allclose(mine, its, atol=1e-6)
    half, _ = model_of(message, 320, 180, 0, 0, "camera_intrinsics")
    for mine, its in zip(model.project(POINTS)[:2], half.project(POINTS)[:2], strict=True):
        assert np.allclose(mine / 2, its, atol=1e-6)


def test_a_lens_that_alpasim_does_not_have() -> None:
    model = CameraModel(64, 36, 32.0, 32.0, 32.0, 18.0, lens=Mei(xi=0.8))
    with pytest.raises(FieldError, match="camera 'side': AlpaSim has no lens of the type 'mei'"):
        camera_message("side", model)


def test_too_many_coefficients_are_named() -> None:
    message = camera_message("front", CameraModel(64, 36, 32.0, 32.0, 32.0, 18.0))
    message.opencv_pinhole_param.tangential_coeffs.extend([0.0] * 3)
    with pytest.raises(
        FieldError, match=r"camera_intrinsics.opencv_pinhole_param.tangential_coeffs: must be at most 2"
    ):
        model_of(message, 64, 36, 0, 0, "camera_intrinsics")


@pytest.mark.parametrize(("name", "value"), [("focal_length_x", 1e-200), ("principal_point_y", -1e30)])
def test_numbers_that_no_camera_has(name: str, value: float) -> None:
    message = camera_message("front", CameraModel(64, 36, 32.0, 32.0, 32.0, 18.0))
    setattr(message.opencv_pinhole_param, name, value)
    with pytest.raises(FieldError, match="camera_intrinsics.opencv_pinhole_param: focal lengths from 0.01"):
        model_of(message, 64, 36, 0, 0, "camera_intrinsics")


def test_poses() -> None:
    pose = make_pose(np.array([12.5, -3.25, 0.5]), quaternion_from_yaw(0.7))
    assert np.allclose(pose_of(pose_message(pose), "pose"), pose, atol=1e-6)
    keys = trajectory_message([5, 7], [pose, np.eye(4)]).poses
    assert [one.timestamp_us for one in keys] == [5, 7]
    broken = pose_message(pose)
    broken.quat.w = 3.0
    with pytest.raises(FieldError, match="pose.quat: must be a unit quaternion"):
        pose_of(broken, "pose")


def test_where_plain_text_goes(tmp_path: Any) -> None:
    assert all(map(is_loopback, ("localhost", "127.0.0.1", "127.8.0.1", "::1", "[::1]")))
    assert not any(map(is_loopback, ("0.0.0.0", "::", "10.0.0.1", "example.org", "")))
    channel_to("localhost:1", None, "--driver-address").close()
    channel_to(f"unix:{tmp_path}/s.sock", None, "--driver-address").close()
    for address in ("example.org:5", "0.0.0.0:5"):
        with pytest.raises(UnisimError, match="which takes TLS"):
            channel_to(address, None, "--driver-address")
    for address in ("localhost", "localhost:0", "localhost:99999", "http://localhost:5", ":5"):
        with pytest.raises(UnisimError, match="must be HOST:PORT"):
            channel_to(address, None, "--driver-address")


def test_the_shutters_time_is_the_exposures_middle() -> None:
    shutter = RollingShutter(0.02, 0.25)
    model = CameraModel(64, 36, 32.0, 32.0, 32.0, 18.0, shutter)
    start_s, end_s = shutter.exposure_s(1.0)
    message = camera_message("front", model)
    back, time_us = model_of(message, 64, 36, round(start_s * 1e6), round(end_s * 1e6), "camera_intrinsics")
    assert back.shutter.exposure_s(time_us / 1e6) == pytest.approx((start_s, end_s))
    # it was stamped elsewhere within the exposure
    assert back.shutter != shutter and replace(back, shutter=shutter) == model
