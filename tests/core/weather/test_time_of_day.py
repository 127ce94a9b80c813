"""Time of day: the light's curve, lamps in closed form, a street's true night, and the bytes of parts and sweeps."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from drive_frames import DriveFrames
from numpy.typing import NDArray
from small_log import write_small_log

from unisim_blender.core import native
from unisim_blender.core.colour import linear_from_srgb, srgb_from_linear
from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.prepare.scenario_plan import RenderOptions, plan_scenario
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.weather import time_of_day
from unisim_blender.core.weather.camera import LUMINANCE
from unisim_blender.core.weather.time_of_day import STREET_HEAD, Lamps, light_of, shown, street_heads, street_light
from unisim_blender.core.world.replay import DriveStates
from unisim_blender.core.world.weather import AS_RECORDED_DEG, Weather, WeatherKeys
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


def test_a_street_lamp_lights_the_ground_by_its_flux_and_the_square_of_the_distance() -> None:
    heads = np.array([[0, 0, 8.0]])
    down = (np.arange(4000) + 0.5) / 4000  # cosines of the angle from straight down, on a sphere of 2 m about the head
    sphere = heads + 2 * np.stack([np.sqrt(1 - down**2), 0 * down, -down], 1)
    candela = street_light(heads, sphere, np.ones(4000)) / down * 4
    assert 2 * np.pi * candela.mean() == pytest.approx(5000, rel=1e-3)
    ground = street_light(heads, np.array([[0, 0, 0], [0, 10, 0], [60, 0, 0], [0, 3, 9.0]]), np.ones(4))
    below = candela[-1] / 64
    assert ground[0] == pytest.approx(below, rel=2e-3) and (ground[2:] == 0).all()
    sine_2, cosine = 100 / 164, 8 / np.sqrt(164)
    lux = below * (1 + 2 * sine_2) * 64 / 164
    assert ground[1] == pytest.approx(lux * cosine, rel=5e-3)
    wall = street_light(heads, np.array([[0, 10.0, 0]]), np.zeros(1))
    assert wall[0] == pytest.approx(lux * np.sqrt(sine_2) / np.pi, rel=5e-3)


def test_street_lamps_are_on_by_night_whatever_their_order_and_are_read_back() -> None:
    lamps = ((3.0, 4.0, 8.0), (1.0, 2.0, 6.0))
    hill = [street_heads(Weather(street_lamps=some), lambda points: points[:, 2] - 5) for some in (lamps, lamps[::-1])]
    np.testing.assert_array_equal(hill, [[[1, 2, 11], [3, 4, 13]]] * 2)
    keys = WeatherKeys({"sun_elevation_deg": ((0.0, 10.0), (10.0, -10.0))}, Weather(street_lamps=lamps))
    at = [keys.at(time_s) for time_s in (2.0, 8.0)]
    assert [weather and weather.street_lamps for weather in at] == [(), lamps]
    assert WeatherKeys({}, Weather(street_lamps=lamps)).at(0.0) is None
    for weather in (*at, Weather()):
        assert weather is not None
        document = json.loads(json.dumps(weather.to_dict()))
        assert Weather.from_dict(document) == weather and ("street_lamps" in document) == bool(weather.street_lamps)


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

    tips = dark.light.lamps - origin
    lamps = tuple((float(tip[0]), float(tip[1]), float(heights(tip[None])[0])) for tip in tips)

    def look(*street_lamps: tuple[float, float, float]) -> float:
        weather = Weather(sun_elevation_deg=-18.0, street_lamps=street_lamps)
        image = shown(day, state, day.instances, weather, sky, rays, heights, full_sun)
        return float(np.mean((image - night.rgb) ** 2))

    assert 10 * np.log10(np.mean((day.rgb - night.rgb) ** 2) / look()) > 7.5
    # no vehicle of the true night has lamps
    for name, value in (("LEAST_LENGTH_M", np.inf), ("LAMP_CD", 0.0), ("SPREAD_CD", 0.0), ("GLARE_CD", 0.0)):
        monkeypatch.setattr(time_of_day, name, value)
    steps = np.geomspace(0.05, 0.4, 40)
    channels = [min(_error(day.rgb[..., c], night.rgb[..., c], step) for step in steps) for c in range(3)]
    assert look() < float(np.mean(channels)) / 10**0.1
    assert look(*lamps) < look() / 10**0.05


def _error(day: NDArray[np.float32], night: NDArray[np.float32], gain: float) -> float:
    return float(np.mean((srgb_from_linear((linear_from_srgb(day) * gain).astype(np.float32)) - night) ** 2))


@pytest.mark.parametrize("renderer", ("neural", "surfel", "warp"))
@pytest.mark.parametrize("pitch_deg", (-80, 80))
def test_views_of_the_sky_and_of_the_ground_have_weather(renderer: str, pitch_deg: float, tmp_path: Path) -> None:
    if renderer != "neural":
        write_small_log(tmp_path / "log")
    mount = {"position": [1.2, 0, 1.5], "pitch_deg": pitch_deg}
    camera = {"id": "w", "width": 40, "height": 24, "horizontal_fov_deg": 40, "mount": mount}
    document = {
        "format": "unisim-scenario", "version": 1, "name": "sky", "log": "log", "edits": [],
        "sensors": {"cameras": [camera], "lidars": []},
        "weather": {"rain_mm_h": 20, "wetness": 1, "sun_elevation_deg": -5, "street_lamps": [[9, 0, 5]]},
        **({"scene": str(SAMPLE)} if renderer == "neural" else {}),
    }  # fmt: skip
    (tmp_path / "s.json").write_text(json.dumps(document))
    plan, _ = plan_scenario(tmp_path / "s.json", RenderOptions(quality="fast", renderer=renderer))
    frames = DriveFrames(plan.recipe.load(), plan.drive)
    image = frames.camera("w", 1, ("rgb", "depth"))
    assert np.isfinite(image.rgb).all() and image.depth_m is not None
    assert np.isfinite(image.depth_m).all() == (image.depth_m.min() < 9)


@pytest.mark.skipif(native.library() is None, reason="the kernels were not built")
def test_parts_have_the_bits_of_the_whole_and_sweeps_are_those_of_the_day(tmp_path: Path) -> None:
    def frames(**weather: object) -> DriveFrames:
        document = {"format": "unisim-scenario", "version": 1, "name": "dusk", "log": "street", "scene": str(SAMPLE)}
        (tmp_path / "s.json").write_text(json.dumps({**document, "edits": [], "weather": weather}))
        plan, _ = plan_scenario(tmp_path / "s.json", RenderOptions(quality="fast"))
        return DriveFrames(plan.recipe.load(), plan.drive)

    lamps = [[20.0, 0.0, 4.0], [26.0, 4.0, 7.0], [-400.0, 0.0, 8.0]]
    day, dusk, unlit = (
        frames(sun_elevation_deg=90, street_lamps=lamps),
        frames(sun_elevation_deg=-6, street_lamps=lamps),
        frames(sun_elevation_deg=-6),
    )
    camera, lidar = day.captures.camera("front_camera", 240), day.captures.lidar("pandar64")
    time_s = camera.time_s[4]
    assert day.state(camera, time_s).weather is None
    state = dusk.state(camera, time_s)
    bright, whole, dark = (
        one.renderer.render(one.state(camera, time_s), camera, time_s, ("rgb", "depth")) for one in (day, dusk, unlit)
    )
    assert whole.rgb.mean() < 0.7 * bright.rgb.mean()
    assert whole.depth_m is not None and bright.depth_m is not None
    np.testing.assert_array_equal(whole.depth_m, bright.depth_m)
    gain = whole.rgb - dark.rgb
    # near lamps it gets brighter, and where none shines less of the town's light is left
    assert gain.max() > 0.1 and gain.min() < -0.02
    rays = camera_rays(camera, time_s, *pixel_grid(camera.model))
    (head,) = street_heads(Weather(street_lamps=((20.0, 0.0, 4.0),)), dusk.renderer.tracer(state).heights)
    toward = (head - rays.origins) / np.linalg.norm(head - rays.origins, axis=-1, keepdims=True)
    nearest = np.unravel_index((toward * rays.directions).sum(-1).argmax(), rays.time_s.shape)
    np.testing.assert_allclose(linear_from_srgb(whole.rgb[nearest]), STREET_HEAD, atol=0.01)
    part = dusk.renderer.render(state, camera, time_s, region=Region(30, 50, 200, 120)).rgb
    np.testing.assert_array_equal(part, whole.rgb[50:120, 30:200])
    tiles = [tile.frame.rgb for tile in dusk.renderer.progressive(state, camera, time_s, band=32)]
    np.testing.assert_array_equal(np.concatenate(tiles), whole.rgb)
    sweeps = [one.renderer.render(one.state(lidar, 0.4), lidar, 0.4, seed=(1, 2)) for one in (day, dusk)]
    for name in ("depth_m", "intensity", "returned", "return_probability", "instance"):
        np.testing.assert_array_equal(*(getattr(sweep, name) for sweep in sweeps))
