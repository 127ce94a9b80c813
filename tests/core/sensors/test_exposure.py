"""The window of an exposure holds the times of all of its rays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from turning_drive import turning_drive

from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import exposure_window
from unisim_blender.core.world.drive import CameraModel, LidarModel, RollingShutter

SHUTTERS = [RollingShutter(duration, at) for duration in (0.0, 0.03, -0.03, 0.2, -1e-6) for at in (0.0, 0.3, 0.5, 1.0)]


@pytest.mark.parametrize("shutter", SHUTTERS, ids=lambda s: f"{s.duration_s}-{s.reference}")
@pytest.mark.parametrize("size", ((64, 36), (47, 31), (16, 1), (3, 1200)))
def test_an_images_rays_leave_within_its_window(shutter: RollingShutter, size: tuple[int, int]) -> None:
    camera = turning_drive().cameras["front"]
    camera = replace(camera, model=CameraModel(*size, 60.0, 61.0, 32.5, 17.5, shutter))
    for time_s in (-0.05, 0.0, 0.45, 1234.5678):
        start, end = exposure_window(camera, time_s)
        assert start <= time_s <= end
        # cells of 3 pixels end beyond an image that they do not divide
        for up in (1, 2, 3):
            times = camera_rays(camera, time_s, *pixel_grid(camera.model, up)).time_s
            assert start <= times.min() and times.max() <= end
        # and no more than that: all rows, and as many again as cells may reach beyond
        assert end - start <= abs(shutter.duration_s) * (1 + 2 * 16 / size[1]) + 1e-9
        if shutter.duration_s == 0:
            assert start == time_s == end


@pytest.mark.parametrize("offset", (0.0, 0.05, -0.3))
@pytest.mark.parametrize("sweep_s", (0.1, 0.05, 0.0, -0.1))
def test_a_sweeps_rays_leave_within_its_window(offset: float, sweep_s: float) -> None:
    lidar = turning_drive().lidars["top"]
    for columns in (1, 36, 1800):
        model = LidarModel(np.radians([5.0, -5.0]), np.zeros(2), columns, sweep_s, time_offset_s=offset)
        one = replace(lidar, model=model)
        for time_s in (0.0, 0.7, 1234.5678):
            start, end = exposure_window(one, time_s)
            times = lidar_rays(one, time_s).time_s
            assert start <= times.min() and times.max() <= end and start <= time_s <= end
            assert end - start <= abs(sweep_s) + abs(offset) + 1e-9
