"""Drops and flakes: how many there are and how fast, which are the same for all sensors, and against plain loops."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from busy_drive import busy_drive

from unisim_blender.core.geometry import BoolArray, FloatArray, Trajectory, quaternion_from_matrix
from unisim_blender.core.sensors.frames import CameraFrame, LidarFrame
from unisim_blender.core.sensors.lidar import beam_directions, lidar_rays
from unisim_blender.core.weather.atmosphere import extinctions, rain_sizes, snow_sizes
from unisim_blender.core.weather.camera import (
    FURTHEST_M,
    NEAREST_M,
    Air,
    _Moving,
    covered_by,
    drawn_particles,
    weathered,
)
from unisim_blender.core.weather.lidar import MAX_PARTICLE_M, detectable, particle_power, particle_returns
from unisim_blender.core.weather.lidar import weathered as weathered_sweep
from unisim_blender.core.weather.particles import Particles, fall_speed, particle_classes
from unisim_blender.core.world.drive import Camera, CameraModel, Drive, Lidar, LidarModel, RollingShutter
from unisim_blender.core.world.weather import Receiver, Weather

RAIN, SNOW = Weather(rain_mm_h=25.0), Weather(snow_mm_h=2.5)
AIR = Air(np.full(3, 0.8), np.zeros((3, 4), np.float32))


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Drive:
    return busy_drive(tmp_path_factory.mktemp("busy"))


def everything(points: FloatArray, radius: float) -> BoolArray:
    return np.ones(len(points), bool)


def all_in(weather: Weather, low: list[float], high: list[float], time_s: float) -> Particles:
    """All particles in a box, whatever their class."""
    parts = [p for g in particle_classes(weather) for p in g.inside(np.array(low), np.array(high), time_s, everything)]
    points, diameters = (np.concatenate(x) for x in zip(*parts, strict=True))
    inside = ((points >= low) & (points < high)).all(1)
    return Particles(points[inside], diameters[inside])


def test_extinction_is_that_of_published_formulas() -> None:
    """Twice the areas of Marshall and Palmer's drops, (pi / 2) D², integrate to pi N0 / slope³: with N0 8000 per m³ and mm and
    a slope of 4.1 R^-0.21 per mm that is 0.365 R^0.63 per km. In snow one sees some hundred metres."""
    for rate in (1.0, 5.0, 25.0, 100.0):
        assert extinctions(Weather(rain_mm_h=rate))["rain"] == pytest.approx(0.3647e-3 * rate**0.63, rel=1e-3)
    assert 200 < 3.912 / extinctions(Weather(snow_mm_h=2.5))["snow"] < 800
    assert fall_speed("rain", 2.0) == pytest.approx(6.55, abs=0.02) and 0.9 < fall_speed("snow", 4.0) < 1.1


@pytest.mark.parametrize("weather", [RAIN, SNOW, Weather(rain_mm_h=3.0)])
def test_numbers_and_sizes_follow_the_distribution(weather: Weather) -> None:
    sizes = rain_sizes(weather.rain_mm_h) if weather.rain_mm_h else snow_sizes(weather.snow_mm_h)
    found = all_in(weather, [0, 0, 0], [12, 12, 8], 3.0)
    for melted in (1.0, 1.7, 2.3):
        larger = (found.diameters_m > float(sizes.diameter_mm(np.array(melted))) * 1e-3).sum() / (12 * 12 * 8)
        expected = sizes.count(melted) - sizes.count(6.0 if weather.rain_mm_h else 4.0)
        assert larger == pytest.approx(expected, rel=0.05, abs=0.2)
    spread = np.histogramdd(found.positions, bins=(4, 4, 4))[0]
    assert spread.std() < 3 * math.sqrt(spread.mean()), "they are spread evenly"


def test_particles_fall_and_heavier_rain_moves_none() -> None:
    (group, *_) = particle_classes(RAIN)
    low, high = np.zeros(3), np.full(3, 2.0)
    before = np.concatenate([p.positions for p in group.inside(low, high, 1.0, everything)])
    fallen = np.array([0, 0, -0.01 * group.speed_m_s])
    after = np.concatenate([p.positions for p in group.inside(low + fallen, high + fallen, 1.01, everything)])
    np.testing.assert_allclose(after, before + fallen, atol=1e-9)
    heavier, _ = (list(particle_classes(replace(RAIN, rain_mm_h=r))) for r in (40.0, 25.0))
    more = np.concatenate([p.positions for p in heavier[0].inside(low, high, 1.0, everything)])
    assert len(more) > len(before) and {tuple(p) for p in before.tolist()} <= {tuple(p) for p in more.tolist()}
    (other, *_) = particle_classes(replace(RAIN, seed=1))
    elsewhere = np.concatenate([p.positions for p in other.inside(low, high, 1.0, everything)])
    assert not {tuple(p) for p in elsewhere.tolist()} & {tuple(p) for p in before.tolist()}


def still_camera(model: CameraModel, velocity: tuple[float, float, float] = (0, 0, 0)) -> Camera:
    """A camera that looks along x."""
    axes = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    positions = np.array([0.0, 0, 1.5]) + np.outer([-1.0, 1.0], velocity)
    turned = np.repeat(quaternion_from_matrix(axes)[None], 2, 0)
    return Camera("front", model, Trajectory(np.array([-1.0, 1.0]), positions, turned), {0: 0.0})


@pytest.mark.parametrize(("weather", "shutter"), [(RAIN, RollingShutter()), (SNOW, RollingShutter(0.01, 0.5))])
def test_streaks_are_those_of_a_plain_loop(weather: Weather, shutter: RollingShutter) -> None:
    """Each particle followed through its exposure in many small steps, at the time of the line that shows it."""
    camera = still_camera(CameraModel(160, 120, 400.0, 400.0, 80.0, 60.0, shutter), (8.0, 0.5, 0))
    group = list(particle_classes(weather))[1 if weather is RAIN else 3]
    moving = _Moving(camera, 0.0, group, 0.004)
    drawn = np.zeros(160 * 120)
    for covered in moving.drawn():
        drawn += np.bincount(covered.pixels, covered.opacity, drawn.size)
    expected = np.zeros((120, 160))
    low, high = np.array([-1.0, -3, -1.5]), np.array([moving.far_m + 1, 3, 4.5])
    parts = list(group.inside(low, high, 0.0, everything))
    points, diameters = (np.concatenate(x) for x in zip(*parts, strict=True))
    beside = np.abs(points - [0, 0, 1.5])[:, 1:].max(1) < 0.25 * np.abs(points[:, 0]) + 0.7
    for point, diameter in zip(points[beside], diameters[beside], strict=True):
        now = 0.0
        for _ in range(3):
            u, v, z = projected(camera, point + [0, 0, -group.speed_m_s * now], now)
            now = float(moving.times_s[int(np.clip(v, 0, 119))]) if z > 0 else 0.0
        if not NEAREST_M < z < moving.far_m or not (-60 < u < 220 and -60 < v < 180):
            continue
        for dt in (np.arange(12) + 0.5) / 12 * 0.004 - 0.002:
            u, v, _ = projected(camera, point + [0, 0, -group.speed_m_s * (now + dt)], now + dt)
            place(expected, u, v, diameter * 400 / z, 1 / 12)
    assert expected.sum() > 0.5
    assert drawn.sum() == pytest.approx(expected.sum(), rel=0.1)
    blurred = [x.reshape(15, 8, 20, 8).sum((1, 3)) for x in (drawn.reshape(120, 160), expected)]
    assert np.corrcoef(blurred[0].ravel(), blurred[1].ravel())[0, 1] > 0.97


def projected(camera: Camera, point: FloatArray, time_s: float) -> tuple[float, float, float]:
    pose = camera.world_from_camera.at(time_s)
    local = pose[:3, :3].T @ (point - pose[:3, 3])
    if local[2] <= 0:
        return -1e3, -1e3, float(local[2])
    u, v, _ = camera.model.project(local)
    return float(u), float(v), float(local[2])


def place(image: FloatArray, u: float, v: float, width: float, share: float) -> None:
    """Spread a disc's area over the pixels near it."""
    inside = [(u + width * a / 6, v + width * b / 6) for a in range(-3, 4) for b in range(-3, 4) if a * a + b * b <= 9]
    for x, y in inside:
        for dx in (-0.5, 0.5):
            for dy in (-0.5, 0.5):
                i, j = math.floor(y + dy), math.floor(x + dx)
                if 0 <= i < image.shape[0] and 0 <= j < image.shape[1]:
                    near = (1 - abs(x - j - 0.5)) * (1 - abs(y - i - 0.5)) if width <= 1 else 0.25
                    image[i, j] += share * math.pi / 4 * width**2 / len(inside) * near


@pytest.mark.parametrize("weather", [RAIN, SNOW])
def test_hits_of_beams_are_those_of_a_plain_loop(weather: Weather) -> None:
    """Every beam at its own time against every particle, where both are then."""
    columns = 30
    model = LidarModel(np.deg2rad([8.0, 3.0, 0.0, -4.0]), np.deg2rad([0.0, 1.5, 0.0, -2.0]), columns=columns)
    turned = Trajectory(
        np.array([-0.2, 0.2]),
        np.array([[-3.0, 0, 1.8], [3.0, 0.4, 1.8]]),
        np.array([[1.0, 0, 0, 0], [0.99, 0, 0, 0.1411]]),
    )
    lidar, receiver = Lidar("top", model, turned, {0: 0.0}), Receiver(divergence_mrad=20.0)
    least = detectable(receiver, 200.0)
    for group in list(particle_classes(weather))[2:3]:
        beams, distances, powers = particle_returns(group, lidar, 0.0, receiver, least, 0.0)
        far_m = float(distances.max())
        expected: dict[tuple[int, float], float] = {}
        rays = lidar_rays(lidar, 0.0)
        low, high = np.array([-11.0, -9, -1]), np.array([11.0, 9, 5])
        batches = list(group.inside(low, high, 0.0, everything))
        points, diameters = (np.concatenate(x) for x in zip(*batches, strict=True))
        for b in range(4):
            for c in range(columns):
                at = points - [0, 0, group.speed_m_s * rays.time_s[b, c]] - rays.origins[b, c]
                along = np.linalg.norm(at, axis=1)
                cosine = np.clip(at @ rays.directions[b, c] / along, -1, 1)
                hit = (np.arccos(cosine) <= np.maximum(0.02, diameters / along) / 2) & (along <= far_m)
                for i in np.flatnonzero(hit):
                    power = particle_power(
                        diameters[i], along[i], 2 * math.pi / (18.8 if weather is RAIN else 20), receiver
                    )
                    if power >= least:
                        expected[b * columns + c, round(float(along[i]), 2)] = float(power)
        got = {(int(b), round(float(d), 2)): float(p) for b, d, p in zip(beams, distances, powers, strict=True)}
        assert len(expected) > 20
        # the seam between a sweep's last and first columns is looked at from one side
        common = expected.keys() & got.keys()
        assert len(common) > 0.98 * max(len(expected), len(got))
        assert all(got[key] == pytest.approx(expected[key], rel=0.02) for key in common)


def test_two_cameras_and_the_sweep_have_the_same_flake() -> None:
    """The largest flake near both cameras is where each of them shows it, and where a beam through it returns."""
    model = CameraModel(400, 300, 400.0, 400.0, 200.0, 150.0)
    cameras = [still_camera(model), replace(still_camera(model), sensor_id="other")]
    shifted = cameras[1].world_from_camera
    cameras[1] = cameras[1].along(
        Trajectory(shifted.times_s, shifted.positions + [0, 0.4, 0.1], shifted.quaternions_wxyz)
    )
    found = all_in(SNOW, [2.5, -0.5, 1.0], [5.0, 0.5, 2.0], 0.0)
    flake = found.positions[found.diameters_m.argmax()]
    still = replace(SNOW, receiver=Receiver(exposure_s=1e-5))
    for camera in cameras:
        covered = drawn_particles(camera, 0.0, still).covered
        u, v, _ = projected(camera, flake, 0.0)
        at = covered.pixels == int(v) * 400 + int(u)
        distance = np.linalg.norm(flake - camera.world_from_camera.at(0.0)[:3, 3])
        assert at.any() and np.abs(covered.range_m[at] - distance).min() < 1e-3
    origin = np.array([0.0, 0.0, 1.5])
    way = flake - origin
    elevation, azimuth = math.asin(way[2] / np.linalg.norm(way)), math.atan2(way[1], way[0])
    one = LidarModel(
        np.array([elevation]), np.zeros(1), columns=3, sweep_s=1e-9, direction=1,
        column_azimuth_rad=azimuth + np.array([-0.1, 0.0, 0.1]),
    )  # fmt: skip
    lidar = Lidar("top", one, Trajectory(np.zeros(1), origin[None], np.array([[1.0, 0, 0, 0]])), {0: 0.0})
    assert np.allclose(beam_directions(one)[0, 1], way / np.linalg.norm(way))
    hits = [particle_returns(g, lidar, 0.0, Receiver(), 1e-9, 0.0) for g in particle_classes(SNOW)]
    ranges = np.concatenate([distance[beam == 1] for beam, distance, _ in hits])
    assert np.abs(ranges - np.linalg.norm(way)).min() < 1e-6


def test_particles_are_hidden_by_what_is_nearer_and_light_dark_images() -> None:
    camera = still_camera(CameraModel(160, 120, 150.0, 150.0, 80.0, 60.0))
    drawn, whole = drawn_particles(camera, 0.0, SNOW), slice(0, 120)
    dark = np.zeros((120, 160, 3), np.float32)
    images = [
        weathered(
            CameraFrame(camera.model, np.eye(4), dark, np.full((120, 160), depth, np.float32)),
            SNOW, AIR, drawn, whole, slice(0, 160), (120, 160),
        )
        for depth in (0.2, 3.0, FURTHEST_M)
    ]  # fmt: skip
    assert images[0].max() < 0.05, "only the air is in front"
    assert images[1].mean() < images[2].mean() and images[2].max() > 0.5
    part = weathered(
        CameraFrame(camera.model, np.eye(4), dark[30:50, 20:90], np.full((20, 70), 3.0, np.float32)),
        SNOW, AIR, drawn, slice(30, 50), slice(20, 90), (120, 160),
    )  # fmt: skip
    np.testing.assert_array_equal(part, images[1][30:50, 20:90])


def test_a_disc_covers_its_area_for_its_part_of_the_exposure() -> None:
    for width in (0.3, 0.9, 1.2, 3.0, 9.0):
        for length in (0.0, 7.0):
            u0, v0, w, d = (np.array([x]) for x in (40.3, 30.6, width, 5.0))
            opacity = np.concatenate(
                [c.opacity for c in covered_by(u0, v0, u0 + length, v0 + length / 3, w, d, 100, 80)]
            )
            assert opacity.sum() == pytest.approx(math.pi / 4 * width**2, rel=0.03)


def test_rain_returns_near_beams_and_dims_targets() -> None:
    model = LidarModel(np.deg2rad(np.linspace(10, -10, 16)), np.zeros(16), columns=600)
    lidar = Lidar("top", model, Trajectory(np.zeros(1), np.array([[0, 0, 1.8]]), np.array([[1.0, 0, 0, 0]])), {0: 0.0})
    rays = lidar_rays(lidar, 0.0)

    def clear(distance_m: float) -> LidarFrame:
        full = np.full(rays.time_s.shape, distance_m, np.float32)
        return LidarFrame(
            model, np.eye(4), rays.origins, rays.directions, rays.time_s, full, 0 * full + 0.2, 0 * full + 1, full > 0,
            np.ones(full.shape, np.int32), ("wall",),
        )  # fmt: skip

    shares = {}
    for rate in (2.0, 25.0):
        rainy = weathered_sweep(clear(40.0), lidar, Weather(rain_mm_h=rate), 0.0)
        drops = rainy.returned & (rainy.instance == 0)
        shares[rate] = drops.mean()
        assert rainy.depth_m[drops].max() <= MAX_PARTICLE_M
        again = weathered_sweep(clear(40.0), lidar, Weather(rain_mm_h=rate), 0.0)
        np.testing.assert_array_equal(again.depth_m, rainy.depth_m)
    assert 0 < shares[2.0] < shares[25.0] < 0.4
