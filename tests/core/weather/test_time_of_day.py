"""Time of day: the light's curve, lamps in closed form, a street's true night, and the bytes of parts and sweeps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from drive_frames import DriveFrames
from numpy.typing import NDArray

from unisim_blender.core import native
from unisim_blender.core.colour import linear_from_srgb, srgb_from_linear
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.weather import time_of_day
from unisim_blender.core.weather.camera import LUMINANCE
from unisim_blender.core.weather.time_of_day import Lamps, light_of, shown
from unisim_blender.core.world.replay import DriveStates
from unisim_blender.core.world.weather import AS_RECORDED_DEG, Weather
from unisim_street.street import build_street
from unisim_street.truth import truth_camera

SAMPLE = Path(__file__).parents[3] / "sample" / "scene"


def test_light_falls_with_the_sun_and_is_the_recorded_one_at_its_highest() -> None:
    recorded = light_of(AS_RECORDED_DEG)
    np.testing.assert_allclose((*recorded.ground, *recorded.sky), 1, atol=1e-3)
    elevations = (90, 40, 10, 0, -3, -6, -12, -18)
    levels = [light_of(elevation) for elevation in elevations]
    assert (np.diff([light.ground @ LUMINANCE for light in levels]) < 0).all()
    # twilight is bluer than the ground's light at night, and skies are darker at night
    assert light_of(-6).sky[2] / light_of(-6).sky[0] > 1.2 > 1 > light_of(-18).ground[2] / light_of(-18).ground[0]
    assert light_of(-18).sky.max() < 0.1 and Weather(sun_elevation_deg=AS_RECORDED_DEG).is_clear


def test_lamps_light_what_is_ahead_by_the_square_of_its_distance() -> None:
    lamps = Lamps(np.eye(4), 0.0)
    ahead = np.array([[10.0, 0, -0.3], [20, 0, -0.6], [-10, 0, -0.3], [10, 0, 0.5], [10, 9, -0.3], [200, 0, -6]])
    wall = lamps.light(ahead, np.zeros(6))
    assert wall[0] == pytest.approx(4 * wall[1]) and (wall[[2, 5]] == 0).all()
    assert wall[3] < 0.1 * wall[0] and wall[4] < 0.1 * wall[0]  # above the cut-off, and beside the beam
    ground = lamps.light(ahead, np.ones(6))
    assert ground[0] == pytest.approx(wall[0] / 0.7 * 0.3 / np.hypot(10, 0.3))


@pytest.mark.parametrize("seed", (0, 3))
def test_a_night_is_nearer_to_a_streets_true_one_than_any_gain_and_tint_of_its_day(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    street, dark = build_street(seed=seed), build_street(seed=seed, kind="night")
    drive, frame = street.drive, 5
    day, night = (truth_camera(one, one.drive, "front_camera", frame, 240) for one in (street, dark))
    camera = drive.cameras["front_camera"].resized(240)
    time_s = camera.time_s[frame]
    rays, origin = camera_rays(camera, time_s, *pixel_grid(camera.model)), drive.world_origin

    def heights(points: FloatArray) -> FloatArray:
        return points[:, 2] + origin[2] - street.ground_height(points[:, :2] + origin[:2])

    state = DriveStates(drive, {}).state(time_s - 0.01, time_s + 0.01)
    assert day.depth_m is not None
    sky = ~np.isfinite(day.depth_m)
    low = np.zeros(sky.shape, bool)
    low[~sky] = np.abs(heights((rays.origins + rays.directions * day.depth_m[..., None])[~sky])) < 0.15
    full_sun = float(np.quantile(linear_from_srgb(day.rgb[low]) @ LUMINANCE, 0.9))

    def look() -> float:
        image = shown(day, state, day.instances, -18.0, sky, rays, heights, full_sun)
        return float(np.mean((image - night.rgb) ** 2))

    assert 10 * np.log10(np.mean((day.rgb - night.rgb) ** 2) / look()) > 7.5
    monkeypatch.setattr(time_of_day, "LAMPS_DEG", -90.0)  # no vehicle of the true night has lamps
    steps = np.geomspace(0.05, 0.4, 40)
    channels = [min(_error(day.rgb[..., c], night.rgb[..., c], step) for step in steps) for c in range(3)]
    assert look() < float(np.mean(channels)) / 10**0.1


def _error(day: NDArray[np.float32], night: NDArray[np.float32], gain: float) -> float:
    return float(np.mean((srgb_from_linear((linear_from_srgb(day) * gain).astype(np.float32)) - night) ** 2))


@pytest.mark.skipif(native.library() is None, reason="the kernels were not built")
def test_parts_have_the_bits_of_the_whole_and_sweeps_are_those_of_the_day(tmp_path: Path) -> None:
    def frames(**weather: float) -> DriveFrames:
        document = {"format": "unisim-scenario", "version": 1, "name": "dusk", "log": "street", "scene": str(SAMPLE)}
        (tmp_path / "s.json").write_text(json.dumps({**document, "edits": [], "weather": weather}))
        plan, _ = plan_scenario(tmp_path / "s.json", RenderOptions(quality="fast"))
        return DriveFrames(plan.recipe.load(), plan.drive)

    day, dusk = frames(sun_elevation_deg=90), frames(sun_elevation_deg=-6)
    camera, lidar = day.captures.camera("front_camera", 240), day.captures.lidar("pandar64")
    time_s = camera.time_s[4]
    assert day.state(camera, time_s).weather is None
    state = dusk.state(camera, time_s)
    bright, whole = (
        one.renderer.render(one.state(camera, time_s), camera, time_s, ("rgb", "depth")) for one in (day, dusk)
    )
    assert whole.rgb.mean() < 0.7 * bright.rgb.mean()
    assert whole.depth_m is not None and bright.depth_m is not None
    np.testing.assert_array_equal(whole.depth_m, bright.depth_m)
    part = dusk.renderer.render(state, camera, time_s, region=Region(30, 50, 200, 120)).rgb
    np.testing.assert_array_equal(part, whole.rgb[50:120, 30:200])
    tiles = [tile.frame.rgb for tile in dusk.renderer.progressive(state, camera, time_s, band=32)]
    np.testing.assert_array_equal(np.concatenate(tiles), whole.rgb)
    sweeps = [one.renderer.render(one.state(lidar, 0.4), lidar, 0.4, seed=(1, 2)) for one in (day, dusk)]
    for name in ("depth_m", "intensity", "returned", "return_probability", "instance"):
        np.testing.assert_array_equal(*(getattr(sweep, name) for sweep in sweeps))
