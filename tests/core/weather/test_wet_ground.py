"""Wet ground: its closed forms, what it reflects in a scene that is known, and the ground returns that it takes away."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from examples.plugins.chequered_ground import ChequeredGround, ChequeredTracer
from unisim_blender.core.colour import linear_from_srgb
from unisim_blender.core.geometry import FloatArray, Trajectory, quaternion_from_matrix
from unisim_blender.core.meshes.hits import MeshHits
from unisim_blender.core.render.frame_weather import mirrored
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracer import TraceResult, active_actors
from unisim_blender.core.sensors.frames import LidarFrame, RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.weather.camera import LUMINANCE
from unisim_blender.core.weather.wet_ground import (
    DIFFUSE_REFLECTANCE,
    INTERNAL_REFLECTANCE,
    WATER_INDEX,
    beam_gain,
    fresnel,
    seen_through,
)
from unisim_blender.core.world.drive import Camera, CameraModel, Lidar, LidarModel
from unisim_blender.core.world.replay import WorldState
from unisim_blender.core.world.weather import Weather

WALL_X_M, WALL_TOP_M, EYE_M = 20.0, 5.0, 1.6
WALL, SKY = np.array([0.8, 0.2, 0.1], np.float32), np.array([0.5, 0.7, 1.0], np.float32)
STANDING = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))


class Walled(ChequeredGround):
    """The plane, and a red wall across it."""

    def bind(self, state: WorldState) -> WalledTracer:
        return WalledTracer(self, active_actors(state, {"": None}))


class WalledTracer(ChequeredTracer):
    def trace(
        self, rays: Rays, passes: set[str], sky: bool, mesh_hits: MeshHits | None, stats: RenderStats
    ) -> TraceResult[Any]:
        traced = super().trace(rays, passes, sky, mesh_hits, stats)
        flat = rays.flat()
        ahead = np.maximum(flat.directions[:, 0], 1e-9)
        distance = (WALL_X_M - flat.origins[:, 0]) / ahead
        height = flat.origins[:, 2] + distance * flat.directions[:, 2]
        hit = (flat.directions[:, 0] > 1e-9) & (height >= 0) & (height < WALL_TOP_M)
        traced.feature[hit], traced.opacity[hit] = WALL, 1
        traced.maps["depth"][hit] = distance[hit]
        return traced


def camera() -> Camera:
    """A camera at 1.6 m that looks along x."""
    turned = quaternion_from_matrix(np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]))[None]
    at = Trajectory(np.zeros(1), np.array([[0, 0, EYE_M]]), turned)
    return Camera("front", CameraModel(320, 240, 300.0, 300.0, 160.0, 120.0), at, {0: 0.0})


def state(weather: Weather | None) -> WorldState:
    return WorldState(0.0, 0.0, STANDING, weather=weather)


def test_water_reflects_as_fresnel_says() -> None:
    assert fresnel(np.array([1.0]))[0] == pytest.approx(((WATER_INDEX - 1) / (WATER_INDEX + 1)) ** 2)
    assert fresnel(np.array([0.0]))[0] == pytest.approx(1.0)
    brewster = math.cos(math.atan(WATER_INDEX))
    across = ((1 - WATER_INDEX**2) / (1 + WATER_INDEX**2)) ** 2
    assert fresnel(np.array([brewster]))[0] == pytest.approx(across / 2)
    diffuse = quad(lambda c: 2 * c * float(fresnel(np.array([c]))[0]), 0, 1)[0]
    assert diffuse == pytest.approx(DIFFUSE_REFLECTANCE, abs=0.001)


def test_a_wet_albedo_is_that_of_lekner_and_dorf() -> None:
    """What comes out of the film in all directions is (1 - R) a (1 - p) / (1 - p a): asphalt is about half as bright."""
    for albedo in (0.05, 0.12, 0.4):
        out = quad(lambda c, a=albedo: 2 * c * float(seen_through(np.array([a]), np.array([c]))[0]), 0, 1)[0]
        film = (1 - DIFFUSE_REFLECTANCE) * (1 - INTERNAL_REFLECTANCE) / (1 - INTERNAL_REFLECTANCE * albedo)
        assert out == pytest.approx(film, rel=0.002)
    assert 0.45 < seen_through(np.array([0.12]), np.array([1.0]))[0] < 0.6


def test_rain_wets_the_ground() -> None:
    assert Weather().wet == 0 and Weather(wetness=0.3).wet == pytest.approx(0.3)
    wet = [Weather(rain_mm_h=rate, wetness=0.3).wet for rate in (0.0, 0.5, 2.0, 25.0)]
    assert wet == sorted(wet) and wet[2] == pytest.approx(1 - 0.7 / math.e) and wet[-1] > 0.999
    assert not Weather(wetness=0.1).is_clear


def test_ground_is_darker_and_shows_the_wall_and_the_sky_above_it() -> None:
    """In the rows where a mirrored ray meets the wall, or the sky alone, to the last thousandth."""
    renderer, at = Renderer(Walled()), camera()
    wet = Weather(wetness=0.8)
    clear, shown = (renderer.render(state(w), at, 0.0, ("rgb", "depth")) for w in (None, wet))
    pending = renderer._expose(state(wet), at, 0.0, ())
    air = pending.air
    assert air is not None
    mirror = mirrored(pending, renderer._bound, air)
    assert clear.depth_m is not None and set(np.unique(mirror.ground)) == {0.0, 1.0}
    np.testing.assert_array_equal(shown.rgb[:90], clear.rgb[:90])
    dry = linear_from_srgb(clear.rgb).astype(np.float64)
    for row, reflected in ((160, WALL), (239, SKY)):
        down = (row + 0.5 - 120) / 300
        away = EYE_M / down
        assert (EYE_M * (WALL_X_M - away) / away < WALL_TOP_M) == (reflected is WALL)
        cosine = np.array([down / math.hypot(1, down)])
        albedo = np.clip(dry[row, 160] @ LUMINANCE / (air.light @ LUMINANCE), 0, 0.9)
        expected = dry[row, 160] * (1 - 0.8 + 0.8 * seen_through(albedo, cosine)[0])
        expected += 0.8 * fresnel(cosine) * linear_from_srgb(reflected)
        # mirrored light is drawn out, over some rows: near the limits of the wall it is mixed
        np.testing.assert_allclose(linear_from_srgb(shown.rgb[row, 160]), expected, atol=0.02)
    assert shown.rgb[160, 160, 0] / shown.rgb[160, 160, 2] > 1.05 * clear.rgb[160, 160, 0] / clear.rgb[160, 160, 2]
    region = Region(90, 130, 230, 220)
    part = renderer.render(state(wet), at, 0.0, region=region)
    np.testing.assert_array_equal(part.rgb, shown.rgb[region.top : region.bottom, region.left : region.right])


def ground_sweep() -> tuple[LidarFrame, Lidar]:
    """Beams from 1.8 m that hit a plane at up to 80 m, reflectivity .1."""
    distances = np.linspace(5, 80, 31)
    model = LidarModel(-np.arctan2(1.8, distances), np.zeros(31), columns=200)
    lidar = Lidar("top", model, Trajectory(np.zeros(1), np.array([[0, 0, 1.8]]), np.array([[1.0, 0, 0, 0]])), {0: 0.0})
    rays = lidar_rays(lidar, 0.0)
    depth: FloatArray = -1.8 / rays.directions[..., 2]
    full = np.ones(depth.shape, np.float32)
    return LidarFrame(
        model, np.eye(4), rays.origins, rays.directions, rays.time_s, depth.astype(np.float32), 0.1 * full, full,
        full > 0, np.zeros(depth.shape, np.int32),
    ), lidar  # fmt: skip


def test_wet_ground_returns_less_and_is_lost_from_some_range_on() -> None:
    clear, lidar = ground_sweep()
    renderer = Renderer(ChequeredGround())
    ranges = []
    for wetness in (0.0, 0.5, 0.9, 1.0):
        wet = renderer.sweep_in_weather(clear, state(Weather(wetness=wetness) if wetness else None), lidar, 0.0)
        by_beam = wet.returned.mean(1)
        assert set(by_beam) <= {0.0, 1.0} and (np.diff(by_beam) <= 0).all()
        ranges.append(float(clear.depth_m[wet.returned].max()))
        cosine = -clear.directions[wet.returned][:, 2]
        np.testing.assert_allclose(
            wet.intensity[wet.returned], 0.1 * beam_gain(np.full(len(cosine), 0.1), cosine, wetness), rtol=1e-5
        )
    assert ranges[:2] == [ranges[0]] * 2 and 20 < ranges[3] < ranges[2] <= ranges[0]
    standing = replace(clear, origins=clear.origins + [0, 0, 1.0])
    above = renderer.sweep_in_weather(standing, state(Weather(wetness=1.0)), lidar, 0.0)
    np.testing.assert_array_equal(above.returned, clear.returned)
