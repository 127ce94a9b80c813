"""Spray: where it is and how much, the same puffs for all sensors, and its optical depth and returns by plain integrals."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from unisim_blender.core.geometry import Trajectory, quaternion_from_matrix
from unisim_blender.core.sensors.frames import LidarFrame
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.weather.lidar import weathered
from unisim_blender.core.weather.spray import FADING_S, LEAST_DEPTH, Puffs, spray
from unisim_blender.core.world.drive import Actor, Appearance, Camera, CameraModel, Lidar, LidarModel
from unisim_blender.core.world.weather import Weather

WET = Weather(wetness=1.0)


def car(speed: float, start_s: float = -10.0, label: str = "Car") -> Actor:
    """A car that drives along x and is at 20 m at 0 s."""
    times = np.arange(start_s, 2.0, 0.5)
    places = np.stack([20 + speed * times, 0 * times, 0 * times + 0.75], 1)
    path = Trajectory(times, places, np.tile([1.0, 0, 0, 0], (len(times), 1)))
    size = np.array([4.5, 1.8, 1.5])
    return Actor("car", label, size, path, -10.0, 10.0, True, Appearance("car"))


def test_spray_grows_with_speed_and_wetness_behind_vehicles_alone() -> None:
    def water(actor: Actor, weather: Weather = WET) -> float:
        return float(spray([actor], weather, 0.0).cross_m2.sum())

    amounts = [water(car(speed)) for speed in (2.0, 8.0, 16.0, 24.0)]
    assert amounts[0] == 0 and amounts == sorted(amounts) and amounts[2] > 3 * amounts[1] > 0
    assert water(car(20.0), Weather(rain_mm_h=1.0)) < water(car(20.0), Weather(rain_mm_h=10.0)) <= water(car(20.0))
    assert water(car(20.0), Weather()) == water(car(20.0, label="Pedestrian")) == 0
    puffs = spray([car(20.0)], WET, 0.0)
    behind = 20 - puffs.middles[:, 0]
    assert behind.min() > 1.0 and 10 < behind.max() < 55 and np.abs(puffs.middles[:, 1]).max() < 2.5
    assert (puffs.cross_m2 / (2 * np.pi * puffs.radii_m**2) >= LEAST_DEPTH).all()
    order = np.argsort(behind)
    assert (np.diff(puffs.radii_m[order]) > 0).all(), "older puffs are wider"


def test_puffs_stay_where_they_were_left_and_fade() -> None:
    """Whatever part of the path a state holds, which another exposure cuts off elsewhere."""
    early, late = (spray([car(16.0)], WET, time_s) for time_s in (0.0, 0.25))
    parted = replace(car(16.0), world_from_actor=car(16.0).world_from_actor.between(-0.1, 0.1))
    for one, other in zip(early, spray([parted], WET, 0.0), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-9)
    pairs = [(i, j) for i, x in enumerate(early.middles[:, 0]) for j, y in enumerate(late.middles[:, 0]) if x == y or
             abs(x - y) < 1e-6]  # fmt: skip
    assert len(pairs) > 5
    first, second = (np.array(x) for x in zip(*pairs, strict=True))
    np.testing.assert_allclose(late.cross_m2[second], early.cross_m2[first] * math.exp(-0.25 / FADING_S), rtol=1e-6)
    seeded = spray([car(16.0)], replace(WET, seed=1), 0.0)
    assert not np.array_equal(seeded.cross_m2, early.cross_m2)


def test_optical_depth_is_the_integral_of_extinction_along_a_ray() -> None:
    puffs = Puffs(np.array([[10.0, 0.4, 0.2]]), np.array([0.6]), np.array([0.8]))
    direction = np.array([1.0, 0.03, 0.01]) / np.linalg.norm([1.0, 0.03, 0.01])
    t = np.linspace(0, 30, 30001)
    points = t[:, None] * direction - puffs.middles[0]
    density = 0.8 / (2 * np.pi * 0.36) ** 1.5 * np.exp(-(points**2).sum(1) / 0.72)
    rays = Rays(np.zeros((3, 3)), np.tile(direction, (3, 1)), np.zeros(3))
    limits = np.array([30.0, 10.3, 9.0])
    depth, _ = puffs.depth_of(np.zeros(3, int), rays, limits)
    for limit, value in zip(limits, depth, strict=True):
        assert value == pytest.approx(density[t <= limit].sum() * 1e-3, abs=0.06 * density.sum() * 1e-3)
    axes = quaternion_from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))[None]
    camera = Camera("front", CameraModel(160, 120, 200.0, 200.0, 80.0, 60.0), Trajectory(np.zeros(1), np.zeros((1, 3)),
                    axes), {0: 0.0})  # fmt: skip
    surface = np.full((120, 160), 30, np.float32)
    shown = puffs.image_depth(camera, 0.0, surface, slice(0, 120), slice(0, 160))
    assert shown[57, 73] == pytest.approx(float(depth[0]), rel=0.05)
    part = puffs.image_depth(camera, 0.0, surface[40:80, 50:120], slice(40, 80), slice(50, 120))
    np.testing.assert_array_equal(part, shown[40:80, 50:120])
    assert puffs.image_depth(camera, 0.0, surface / 5, slice(0, 120), slice(0, 160)).max() == 0


def test_beams_return_spray_in_front_of_their_targets_and_lose_light_in_it() -> None:
    model = LidarModel(np.deg2rad(np.linspace(4, -8, 25)), np.zeros(25), columns=1440)
    lidar = Lidar("top", model, Trajectory(np.zeros(1), np.array([[0, 0, 1.8]]), np.array([[1.0, 0, 0, 0]])), {0: 0.0})
    rays = lidar_rays(lidar, 0.0)
    full = np.full(rays.time_s.shape, 30, np.float32)
    clear = LidarFrame(
        model, np.eye(4), rays.origins, rays.directions, rays.time_s, full, 0.0002 * full, full / full, full > 0,
        np.ones(full.shape, np.int32), ("wall",),
    )  # fmt: skip
    shares = []
    for speed in (0.0, 10.0, 20.0):
        puffs = spray([car(speed)], WET, 0.0)
        wet = weathered(clear, lidar, WET, 0.0, None, puffs)
        of_spray = wet.returned & (wet.instance == 0)
        shares.append(of_spray.mean())
        if speed:
            points = rays.origins[of_spray] + rays.directions[of_spray] * wet.depth_m[of_spray][:, None]
            apart = np.linalg.norm(points[:, None] - puffs.middles, axis=-1) / puffs.radii_m
            assert apart.min(1).max() < 6 and wet.depth_m[of_spray].max() < 30
            target = wet.instance == 1
            assert (wet.intensity[target] <= clear.intensity[target]).all()
            np.testing.assert_array_equal(weathered(clear, lidar, WET, 0.0, None, puffs).depth_m, wet.depth_m)
    assert shares[0] == 0 and shares[2] > shares[1] > 0
