"""What training takes from LiDAR before its first step, beside plain loops over rays.

Volumes and tables of long and winding drives have room for every place of them, and rows for every metre.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from drive_frames import DriveFrames
from small_log import write_small_log

from unisim_blender.core.errors import SceneError
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    invert_pose,
    make_pose,
    points_in_box,
    quaternion_from_yaw,
    transform_points,
)
from unisim_blender.core.model.checkpoint import load_scene
from unisim_blender.core.model.occupancy import BESIDE, FREE, HIT, UNKNOWN
from unisim_blender.core.model.shapes import MAX_VOXELS, cells_of, check_config, check_sizes
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.presets import PRESETS, preset
from unisim_blender.core.render.renderer import Renderer
from unisim_blender.core.render.tracers.torch.tracer import TorchBackend
from unisim_blender.core.training import seeding
from unisim_blender.core.training.batches.data import LidarData
from unisim_blender.core.training.batches.sweeps import boxes_of, some_of_each
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.loop import train
from unisim_blender.core.training.seeding import AWAY_M, free_away, seed_voxels, sized
from unisim_blender.core.world.drive import Actor, Appearance, Drive

SHAPE, VOXEL_M = (40, 30, 12), 0.5


def rays(count: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(3)
    origins = np.array([3.0, 4.0, 2.0]) + rng.normal(0, 0.3, (count, 3))
    # some end outside of the volume, on either side of it
    return origins, rng.uniform([-4, -4, 0.2], [24, 19, 7], (count, 3))


def plainly(origins: FloatArray, points: FloatArray) -> FloatArray:
    def cell(x: FloatArray) -> tuple[int, ...] | None:
        at = np.floor(x / VOXEL_M).astype(int)
        return tuple(at) if (at >= 0).all() and (at < SHAPE).all() else None

    values = np.full(SHAPE, UNKNOWN)
    step = 0.75 * VOXEL_M
    for origin, point in zip(origins, points, strict=True):
        length = np.linalg.norm(point - origin)
        for t in np.arange(0.5 * step, min(length - 2 * VOXEL_M, seeding.FREE_UP_TO_M), step):
            if (at := cell(origin + (point - origin) * t / length)) is not None:
                values[at] = FREE
    hits = [at for point in points if (at := cell(point)) is not None]
    for x, y, z in hits:
        values[max(0, x - 1) : x + 2, max(0, y - 1) : y + 2, max(0, z - 1) : z + 2] = BESIDE
    for at in hits:
        values[at] = HIT
    return values


def test_voxels_are_those_of_single_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(seeding, "_AT_ONCE", 7)
    origins, points = rays(60)
    nowhere = np.full((20, 15), -5.0, np.float32)
    values = seed_voxels(origins, points, SHAPE, VOXEL_M, nowhere, np.zeros((20, 15), bool))
    np.testing.assert_array_equal(values, plainly(origins, points))
    assert {HIT, BESIDE, FREE, UNKNOWN} == set(np.unique(values))


def test_no_ray_tells_of_anything() -> None:
    nothing = np.zeros((0, 3))
    ground = np.zeros((20, 15), np.float32)
    values = seed_voxels(nothing, nothing, SHAPE, VOXEL_M, ground - 5, np.zeros((20, 15), bool))
    assert (values == UNKNOWN).all()


def test_static_returns_are_those_in_no_box() -> None:
    rng = np.random.default_rng(5)
    count = 4000
    turned = np.array([np.cos(0.4), 0, 0, np.sin(0.4)])
    size_m = np.array([4.0, 2.0, 1.5])
    stand = Trajectory(np.array([1.0]), np.array([[5.0, 3.0, 0.5]]), turned[None])
    still = Actor("a", "Car", size_m, stand, 0.2, 0.7, False, Appearance("a"))
    keys = np.array([[0.0, -3.0, 0.5], [6.0, -3.0, 0.5], [9.0, 1.0, 0.5]])
    trajectory = Trajectory(np.array([0.1, 0.5, 0.9]), keys, np.array([[1.0, 0, 0, 0], [1.0, 0, 0, 0], turned]))
    moving = Actor("b", "Car", size_m, trajectory, 0.1, 0.9, True, Appearance("b"))
    data = object.__new__(LidarData)
    data.corner = np.array([-100.0, -50.0, 0.0])
    data.time_s = rng.uniform(0, 1, count)
    data.origins = (np.zeros((count, 3)) - data.corner).astype(np.float32)
    to = rng.uniform([-4, -6, 0], [14, 6, 1.5], (count, 3))
    data.depth_m = np.linalg.norm(to, axis=1)
    data.directions = (to / data.depth_m[:, None]).astype(np.float32)
    data.returned = rng.random(count) < 0.9
    data._hits = np.flatnonzero(data.returned)
    points, times = data.points, data.time_s[data._hits]
    owner = boxes_of(points, times, [still, moving])
    data._static = owner < 0
    inside = [
        any(
            actor.present(t) and points_in_box(p[None], actor.world_from_actor.at(t), np.asarray(actor.size_m) + 0.2)[0]
            for actor in (still, moving)
        )
        for p, t in zip(points, times, strict=True)
    ]
    assert 100 < sum(inside) < len(inside) - 100
    origins, static = data.static_returns()
    np.testing.assert_array_equal(static, points[~np.array(inside)])
    assert origins.shape == static.shape
    some = some_of_each(owner, 40)
    for number in range(2):
        of_actor, chosen = np.flatnonzero(owner == number), some[owner[some] == number]
        assert len(of_actor) > 50 and len(np.unique(chosen)) == 40
        assert np.diff(np.searchsorted(of_actor, chosen)).max() <= np.ceil(len(of_actor) / 40)
    np.testing.assert_array_equal(some_of_each(owner, 10_000), np.flatnonzero(owner >= 0))


def drive_along(metres: float, turn_deg: float, yaw_deg: float = 20.0, frames: int = 101) -> Drive:
    """A drive with a bend of 40 m in its middle, or wherever it has room."""
    s = np.linspace(0, metres, frames)
    arc = abs(np.radians(turn_deg)) * 40.0
    heading = np.radians(turn_deg) * np.clip((s - (metres - arc) / 2) / max(arc, 1e-9), 0, 1) + np.radians(yaw_deg)
    middle = (heading[1:] + heading[:-1]) / 2
    steps = np.diff(s)[:, None] * np.stack([np.cos(middle), np.sin(middle)], -1)
    at = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, 0)])
    times = 0.1 * np.arange(frames)
    positions = np.concatenate([at + [3e5, -2e5], np.full((frames, 1), 40.0)], 1)
    ego = Trajectory(times, positions, quaternion_from_yaw(heading))
    numbers = range(frames)
    return Drive("long", tuple(numbers), {i: float(times[i]) for i in numbers}, ego, {}, {}, {})


def room(drive: Drive, volume: Volume) -> tuple[float, float]:
    """How far a volume reaches at least to the sides of a drive's places, and behind and ahead of its ends, metres."""
    poses = drive.world_from_ego.at(np.array([drive.time_s[frame] for frame in drive.frames]))

    def reach(pose: FloatArray, direction: tuple[float, float]) -> float:
        metres = np.arange(0.0, 200.0, 0.5)
        points = np.concatenate([metres[:, None] * direction, np.zeros((len(metres), 1))], 1)
        local = transform_points(invert_pose(volume.world_from_volume), transform_points(pose, points))
        inside = ((local > -1e-6) & (local < volume.size_m + 1e-6)).all(1)
        return float(metres[np.flatnonzero(~inside)[0] - 1] if not inside.all() else np.inf)

    sides = min(reach(pose, (0.0, side)) for pose in poses for side in (1.0, -1.0))
    return sides, min(reach(poses[0], (-1.0, 0.0)), reach(poses[-1], (1.0, 0.0)))


@pytest.mark.parametrize("metres", [8.0, 120.0, 1000.0])
def test_a_straight_drive_has_the_papers_box(metres: float) -> None:
    volume = Volume.along(drive_along(metres, 0.0))
    np.testing.assert_allclose(volume.size_m, [metres + 160, 120, 40], atol=1e-6)
    assert volume.world_from_volume[1, 0] == pytest.approx(np.sin(np.radians(20.0)))


@pytest.mark.parametrize(("metres", "turn"), [(300.0, 40.0), (120.0, 90.0)])
def test_a_drive_that_turns_little_or_is_short_has_the_box_of_its_way(metres: float, turn: float) -> None:
    drive = drive_along(metres, turn)
    volume = Volume.along(drive)
    ends = drive.world_from_ego.positions[[0, -1]]
    axis = volume.world_from_volume[:3, 0]
    assert axis @ (ends[1] - ends[0]) == pytest.approx(np.linalg.norm(ends[1] - ends[0]))
    assert volume.size_m[0] == pytest.approx(np.linalg.norm(ends[1] - ends[0]) + 160)


@pytest.mark.parametrize("turn", [60.0, 90.0, -90.0, 150.0])
@pytest.mark.parametrize("metres", [200.0, 1000.0])
def test_a_winding_drive_has_a_straight_ones_room_everywhere(metres: float, turn: float) -> None:
    drive = drive_along(metres, turn)
    volume = Volume.along(drive)
    sides, ends = room(drive, volume)
    assert sides >= 60 - 0.5 and ends >= 80 - 0.5
    below = drive.world_from_ego.positions[:, 2].min() - volume.corner[2]
    assert below == pytest.approx(8.0) and volume.size_m[2] == pytest.approx(40.0)


def test_a_winding_drives_box_is_small_whichever_way_it_heads() -> None:
    areas = [np.prod(Volume.along(drive_along(1000, 90, yaw)).size_m[:2]) for yaw in (0.0, 31.0, 45.0, 200.0)]
    assert max(areas) < 1.01 * min(areas)
    at_an_angle = drive_along(1000, 90, 31.0)
    places = at_an_angle.world_from_ego.positions[:, :2]
    assert min(areas) < np.prod(np.ptp(places, axis=0) + 160)


@pytest.mark.parametrize(
    ("metres", "more"), [(0.0, 0), (8.0, 0), (160.0, 0), (285.0, 0), (320.0, 1), (1000.0, 2), (6000.0, 4)]
)
def test_tables_grow_with_the_way(metres: float, more: int) -> None:
    config = preset("tiny").model
    drive = drive_along(metres, 0.0)
    found = sized(config, drive, Volume.along(drive))
    assert found.static_grid.log2_table == config.static_grid.log2_table + more
    assert (found is config) == (more == 0)
    assert replace(found, static_grid=config.static_grid) == config


def test_tables_have_an_end() -> None:
    paper, drive = preset("paper").model, drive_along(6000.0, 0.0)
    assert sized(paper, drive, Volume.along(drive)).static_grid.log2_table == seeding.MOST_ROWS_LOG2


@pytest.mark.parametrize("name", PRESETS)
@pytest.mark.parametrize(
    ("metres", "turn", "voxel_m"), [(1000.0, 90.0, 0.5), (3000.0, 90.0, 0.75), (9000.0, 0.0, 0.55), (9000.0, 90.0, 1.5)]
)
def test_what_is_trained_can_be_read(name: str, metres: float, turn: float, voxel_m: float) -> None:
    drive = drive_along(metres, turn)
    volume = Volume.along(drive)
    found = sized(preset(name).model, drive, volume)
    assert found.voxel_m == voxel_m
    assert math.prod(cells_of(volume.size_m, voxel_m)) <= MAX_VOXELS
    assert voxel_m == 0.5 or math.prod(cells_of(volume.size_m, voxel_m - 0.05)) > MAX_VOXELS
    check_config(found, "model")
    check_sizes(found, Volume.from_dict(volume.to_dict()), "model")


def test_a_drive_too_long_for_a_scene_is_refused_before_it_is_trained() -> None:
    drive = drive_along(10_000.0, 0.0)
    with pytest.raises(SceneError, match=r"^long: too long for one scene, train parts of it: .* below 10000 m$"):
        sized(preset("tiny").model, drive, Volume.along(drive))


def test_nothing_is_looked_for_away_from_a_winding_drive() -> None:
    drive = drive_along(600.0, 90.0)
    volume = Volume.along(drive)
    shape = np.ceil(volume.size_m / 2.0).astype(int)
    values = np.random.default_rng(0).choice(np.array([FREE, UNKNOWN, BESIDE, HIT], np.uint8), shape)
    before = values.copy()
    free_away(values, volume, 2.0, drive)
    changed = values != before
    assert (before[changed] == UNKNOWN).all() and (values[changed] == FREE).all()
    centres = (np.argwhere(before == UNKNOWN) + 0.5) * 2.0
    world = transform_points(volume.world_from_volume, centres)
    places = drive.world_from_ego.positions
    away = np.linalg.norm(world[:, None, :2] - places[None, :, :2], axis=-1).min(1)
    freed = changed[before == UNKNOWN]
    assert freed[away > AWAY_M + 10].all() and not freed[away < AWAY_M - 10].any() and 0.1 < freed.mean() < 0.9


def test_all_of_a_straight_drives_box_stays() -> None:
    drive = drive_along(1000.0, 0.0)
    values = np.full((580, 60, 20), UNKNOWN, np.uint8)
    free_away(values, Volume.along(drive), 2.0, drive)
    assert (values == UNKNOWN).all()


def test_a_scene_with_more_rows_is_trained_stored_and_rendered(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_small_log(tmp_path / "log")
    log = open_log(tmp_path / "log")
    config = TrainConfig(
        ("front_camera",), ("pandar64",), (0, 1, 2, 3), preset="tiny", iterations=3, patches=2, patch_cells=8,
        lidar_rays=64,
    )  # fmt: skip
    usual = train(log, config, tmp_path / "usual", quiet=True)
    monkeypatch.setattr(seeding, "USUAL_M", 80.0)
    header = train(log, config, tmp_path / "scene", quiet=True)
    rows = [one.model["static_grid"]["log2_table"] for one in (usual, header)]
    assert rows == [15, 16]
    scene = load_scene(tmp_path / "scene")
    assert scene.model.static.grid.table.shape[0] > load_scene(tmp_path / "usual").model.static.grid.table.shape[0]
    image = DriveFrames(Renderer(TorchBackend(scene)), scene.header.drive).camera("front_camera", 1, ("rgb",))
    assert np.isfinite(image.rgb).all() and image.rgb.shape == (32, 48, 3)


def test_poses_that_jump_about_one_place_do_not_wind() -> None:
    drive = drive_along(30.0, 0.0, frames=31)
    turned = replace(
        drive, world_from_ego=Trajectory.from_poses(
            drive.world_from_ego.times_s,
            np.stack([make_pose(p, quaternion_from_yaw(i % 4)) for i, p in enumerate(drive.world_from_ego.positions)]),
        ),
    )  # fmt: skip
    np.testing.assert_allclose(Volume.along(turned).size_m, [190, 120, 40], atol=1e-6)
