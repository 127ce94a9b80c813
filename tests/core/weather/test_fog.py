"""Fog in images and sweeps follows its closed forms, and frames in weather are those of any order, part and process."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from busy_drive import backends, busy_drive
from same_frames import assert_same
from scipy.integrate import quad

from unisim_blender.core.colour import linear_from_srgb, srgb_from_linear
from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.render.captures import CaptureStates, render_image, render_sweep, states_of
from unisim_blender.core.render.lattice import Region
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.reuse import FrameReuse
from unisim_blender.core.render.tracer import Backend
from unisim_blender.core.scenario import apply_scenario, scenario_from_json
from unisim_blender.core.scenario.context import EditContext
from unisim_blender.core.sensors.frames import CAMERA_PASSES, CameraFrame, LidarFrame
from unisim_blender.core.simulation.edits import ScenarioDrive
from unisim_blender.core.weather.atmosphere import backscatter, extinctions
from unisim_blender.core.weather.camera import Air
from unisim_blender.core.weather.camera import weathered as camera_weathered
from unisim_blender.core.weather.lidar import (
    cell_length_m,
    detectable,
    is_lost,
    overlap,
    soft_cells,
    soft_power,
    weathered,
)
from unisim_blender.core.world.captures import Capture
from unisim_blender.core.world.drive import CameraModel, Drive, Lidar, LidarModel
from unisim_blender.core.world.encoding import decode_state, encode_state
from unisim_blender.core.world.replay import DriveStates
from unisim_blender.core.world.weather import Receiver, Weather, WeatherKeys

FOG = WeatherKeys({"visibility_m": ((0.0, 1e5), (0.2, 20.0))})


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return busy_drive(tmp_path_factory.mktemp("busy"))


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Backend]:
    return backends(tmp_path_factory.mktemp("scenes"))


def states(renderer: Renderer, drive: Drive, weather: WeatherKeys | None) -> CaptureStates:
    return states_of(renderer, replace(drive, weather=weather))


def test_visibility_is_where_contrast_is_two_percent_and_its_reciprocal_is_linear_in_time() -> None:
    assert math.exp(-extinctions(Weather(visibility_m=300))["fog"] * 300) == pytest.approx(0.02)
    at = FOG.at(0.1)
    assert at is not None and 1 / at.visibility_m == pytest.approx((1e-5 + 1 / 20) / 2)
    before = FOG.at(-3.0)
    assert before is not None and before.visibility_m == pytest.approx(1e5)
    assert WeatherKeys({"rain_mm_h": ((0.0, 0.0),)}).at(1.0) is None


@pytest.mark.parametrize("kind", ["compiled", "torch"])
def test_light_is_attenuated_over_the_depth_and_the_sky_is_airlight(
    loaded: Mapping[str, Backend], drive: Drive, kind: str
) -> None:
    renderer = Renderer(loaded[kind])
    capture = Capture.of_frame(drive.cameras["front"], 1)
    clear = render_image(renderer, states(renderer, drive, None), capture, ("rgb", "depth"))
    ids = render_image(renderer, states(renderer, drive, None), capture, ("rgb", "depth", "instance"))
    foggy = render_image(renderer, states(renderer, drive, FOG), capture, ("rgb", "depth"))
    assert clear.depth_m is not None and foggy.depth_m is not None
    np.testing.assert_array_equal(clear.depth_m, foggy.depth_m)
    sky = np.isinf(clear.depth_m)
    assert 0.02 < sky.mean() < 0.98
    light = linear_from_srgb(foggy.rgb[sky]).astype(np.float64)
    assert np.ptp(light, 0).max() < 1e-6
    at = FOG.at(capture.time_s(drive.cameras["front"]))
    assert at is not None
    time_s = capture.time_s(drive.cameras["front"])
    foggy_state = states(renderer, drive, FOG).state(drive.cameras["front"], time_s)
    air = renderer._frame_weather.air(
        foggy_state, drive.cameras["front"], time_s, renderer.quality, renderer._clear_frame
    )
    size = clear.rgb.shape[0], clear.rgb.shape[1]
    shown = air.sky(replace(clear, instance=ids.instance), slice(None), slice(None), size)
    through = np.exp(np.log(0.02) / at.visibility_m * clear.depth_m.astype(np.float64))[..., None]
    through[shown] = 0
    expected = linear_from_srgb(clear.rgb) * through + light[0] * (1 - through)
    np.testing.assert_allclose(linear_from_srgb(foggy.rgb), expected, atol=2e-6)
    assert np.abs(foggy.rgb - clear.rgb)[~sky].max() > 0.05


def test_a_sheet_of_the_skys_colour_is_sky_where_beams_would_not_return() -> None:
    """A scene has sheets of sky at 15 m on the left and right; in front of them a white lorry, a dark tree and a wall which
    beams return from."""
    air = Air(np.array([0.5, 0.6, 0.8]), np.repeat(np.array([[1, 1, 1, 0]], np.float32), 3, 0))
    sky = np.tile(srgb_from_linear(np.array([0.4, 0.5, 0.9], np.float32)), (30, 40, 1))
    model = CameraModel(40, 30, 40.0, 40.0, 20.0, 15.0)
    instance, depth = np.zeros((30, 40), np.int32), np.full((30, 40), 15, np.float32)
    frame = CameraFrame(model, np.eye(4), sky, depth, instance=instance)
    frame.rgb[20:, :20] = srgb_from_linear(np.array([0.05, 0.1, 0.03], np.float32))
    instance[:10, 5:15] = 1
    depth[:, 20:22] = np.inf
    shown = air.sky(frame, slice(None), slice(None), (30, 40))
    expected = np.repeat(np.arange(40)[None] < 30, 30, 0)
    expected[20:, :20] = expected[:10, 5:15] = False
    np.testing.assert_array_equal(shown, expected)
    part = replace(frame, rgb=sky[4:20, 8:37], depth_m=depth[4:20, 8:37], instance=instance[4:20, 8:37])
    np.testing.assert_array_equal(air.sky(part, slice(4, 20), slice(8, 37), (30, 40)), expected[4:20, 8:37])
    foggy = linear_from_srgb(camera_weathered(frame, Weather(visibility_m=50.0), air))
    np.testing.assert_allclose(foggy[shown], np.broadcast_to(air.light, foggy[shown].shape), atol=1e-5)
    assert np.abs(foggy[~shown] - air.light).min(-1).min() > 1e-3


@pytest.mark.parametrize("kind", ["compiled", "torch"])
def test_weather_that_changes_nothing_leaves_the_bits_and_parts_have_those_of_the_whole(
    loaded: Mapping[str, Backend], drive: Drive, kind: str
) -> None:
    renderer = Renderer(loaded[kind], shadows=True)
    capture = Capture.of_frame(drive.cameras["front"], 1)
    nothing = WeatherKeys({"rain_mm_h": ((0.0, 0.0), (0.1, 0.0), (0.2, 5.0))})
    assert nothing.at(0.1) is None
    plain = render_image(renderer, states(renderer, drive, None), capture, CAMERA_PASSES)
    assert_same(render_image(renderer, states(renderer, drive, nothing), capture, CAMERA_PASSES), plain)
    soaked = WeatherKeys({**FOG.keys, "rain_mm_h": ((0.0, 20.0),), "wetness": ((0.0, 1.0),)})
    foggy = states(renderer, drive, soaked)
    whole = render_image(renderer, foggy, capture)
    height, width = whole.rgb.shape[:2]
    region = Region(width // 3, height // 4, width - 5, height - 2)
    part = render_image(renderer, foggy, capture, ("rgb", "normal"), region=region)
    np.testing.assert_array_equal(part.rgb, whole.rgb[region.top : region.bottom, region.left : region.right])
    camera, time_s = drive.cameras["front"], capture.time_s(drive.cameras["front"])
    tiles = list(renderer.progressive(foggy.state(camera, time_s), camera, time_s, coarse=(8, 4), band=16))
    bands = [tile.frame.rgb for tile in tiles if tile.stride == (1, 1)]
    np.testing.assert_array_equal(np.concatenate(bands), whole.rgb)
    assert all(tile.frame.depth_m is None for tile in tiles) and whole.depth_m is None


def test_a_state_in_weather_is_another_one_and_is_sent_whole(drive: Drive) -> None:
    plain, foggy = (DriveStates(replace(drive, weather=w), {}).state(0.0, 0.1) for w in (None, FOG))
    assert plain != foggy and foggy.weather is not None
    assert decode_state(encode_state(foggy)).weather == foggy.weather
    seeded = replace(foggy, weather=replace(foggy.weather, seed=1))
    assert seeded != foggy and decode_state(encode_state(plain)).weather is None


def test_a_standing_sensor_sees_the_fog_thicken(loaded: Mapping[str, Backend], drive: Drive) -> None:
    renderer, reuse = Renderer(loaded["torch"]), FrameReuse()
    camera = drive.cameras["front"]
    standing = camera.along(
        Trajectory(np.zeros(1), camera.trajectory.positions[:1], camera.trajectory.quaternions_wxyz[:1])
    )
    foggy = states(renderer, replace(drive, cameras={"front": standing}), FOG)
    for frame in (1, 2):
        capture = Capture.of_frame(standing, frame)
        again = render_image(renderer, foggy, capture, reuse=reuse)
        np.testing.assert_array_equal(again.rgb, render_image(renderer, foggy, capture).rgb)


def sweep(distance_m: FloatArray, intensity: FloatArray) -> tuple[LidarFrame, Lidar]:
    """A sweep of targets (B, C) along x."""
    shape = distance_m.shape
    model = LidarModel(np.zeros(shape[0]), np.zeros(shape[0]), columns=shape[1])
    lidar = Lidar("top", model, Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]])), {0: 0.0})
    ones, along = np.ones(shape, np.float32), np.tile([1.0, 0.0, 0.0], (*shape, 1))
    clear = LidarFrame(
        model, np.eye(4), np.zeros_like(along), along, np.zeros(shape), distance_m.astype(np.float32),
        intensity.astype(np.float32), ones, distance_m > 0, np.ones(shape, np.int32), ("car",),
    )  # fmt: skip
    return clear, lidar


def test_the_share_of_lost_beams_follows_its_closed_form() -> None:
    """Reflectivities are even in 0..1: lost are those below threshold (exp(2 a R) - 1) (R / R_max)²."""
    receiver, extinction = Receiver(), 0.02
    rng = np.random.default_rng(0)
    for distance_m in (20.0, 60.0, 100.0, 140.0):
        drawn = rng.random(200_000).astype(np.float32)
        lost = is_lost(drawn, np.full(drawn.shape, distance_m), extinction, receiver, 200.0).mean()
        expected = min(0.1 * (math.exp(2 * extinction * distance_m) - 1) * (distance_m / 200) ** 2, 1.0)
        assert lost == pytest.approx(expected, abs=0.004), distance_m


def test_returns_of_the_air_have_the_ranges_of_the_strongest_of_exponential_powers() -> None:
    """Into the empty sky: the probability that cell k is the strongest, by quadrature."""
    weather = Weather(visibility_m=50.0)
    clear, lidar = sweep(np.zeros((64, 3000)), np.zeros((64, 3000)))
    foggy = weathered(clear, lidar, weather, 0.0)
    receiver, extinction = weather.receiver, extinctions(weather)["fog"]
    least = detectable(receiver, 200.0)
    starts, means = soft_cells(extinction, backscatter(weather), receiver, least, 0.5, 200.0)
    ranges, length = foggy.depth_m[foggy.returned], cell_length_m(receiver)
    assert not foggy.instance[foggy.returned].any()
    for k, start in enumerate(starts):

        def density(x: float, k: int = k) -> float:
            others = np.prod([1 - math.exp(-x / mean) for j, mean in enumerate(means) if j != k])
            return float(math.exp(-x / means[k]) / means[k] * others)

        expected = quad(density, least, 40 * means[k], limit=200)[0]
        share = ((ranges >= start) & (ranges < start + length)).sum() / foggy.returned.size
        assert share == pytest.approx(expected, abs=0.004), start
    assert foggy.returned.mean() == pytest.approx(1 - np.prod(1 - np.exp(-least / means)), abs=0.002)


def test_a_pulse_returns_the_power_of_the_lidar_equation() -> None:
    """A pulse's middle from far away: pi b L exp(-2 a R) xi / R², where L is the pulse's length."""
    receiver = Receiver(overlap_m=0.5)
    length = cell_length_m(receiver)
    power = soft_power(np.array([80.0 + length]), 0.01, 0.002, receiver)[0]
    assert power == pytest.approx(math.pi * 0.002 * length * math.exp(-1.6) / 80**2, rel=0.01)
    assert overlap(np.array([4.0]), Receiver(overlap_m=8.0))[0] == 0.25


def test_targets_are_dimmer_and_hide_the_air_behind_them() -> None:
    near = np.full((8, 500), 6.0)
    clear, lidar = sweep(near, np.full(near.shape, 0.5))
    foggy = weathered(clear, lidar, Weather(visibility_m=100.0), 0.0)
    target = foggy.instance == 1
    assert 0.5 < target.mean() <= 1 and foggy.returned.all()
    np.testing.assert_allclose(foggy.intensity[target], 0.5 * math.exp(2 * math.log(0.02) / 100 * 6), rtol=1e-5)
    assert foggy.depth_m.max() <= 6.0
    blocked = replace(lidar, blocked=np.ones(near.shape, bool))
    sky, _ = sweep(np.zeros(near.shape), np.zeros(near.shape))
    assert not weathered(sky, blocked, Weather(visibility_m=30.0), 0.0).returned.any()


def test_sweeps_in_weather_depend_on_the_seed_and_the_time_alone(
    loaded: Mapping[str, Backend], drive: Drive, tmp_path: Path
) -> None:
    renderer, capture = Renderer(loaded["torch"]), Capture.of_frame(drive.lidars["top"], 1)
    foggy = states(renderer, drive, FOG)
    first = render_sweep(renderer, foggy, capture, 3)
    render_sweep(renderer, foggy, Capture.of_frame(drive.lidars["top"], 2), 3)
    assert_same(render_sweep(Renderer(loaded["torch"]), foggy, capture, 3, FrameReuse()), first)
    other = states(renderer, drive, replace(FOG, constant=Weather(seed=5)))
    assert not np.array_equal(render_sweep(renderer, other, capture, 3).depth_m, first.depth_m)


def test_the_closed_loop_is_in_the_scenarios_weather(drive: Drive) -> None:
    document = {
        "format": "unisim-scenario", "version": 1, "name": "w", "log": "log", "edits": [], "weather": {"visibility_m": 60}
    }  # fmt: skip
    scenario = scenario_from_json(document)
    context = EditContext(scenario, drive, lambda path: {})
    simulated = ScenarioDrive.of(scenario, context, 0, 500_000)
    for one in (simulated.drive(), simulated.with_edits([]), apply_scenario(scenario, drive, lambda path: {})):
        assert one.weather is not None and one.weather.at(0.3) == Weather(visibility_m=60.0)
