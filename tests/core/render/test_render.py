"""The renderer on scenes that are known in closed form, and what the decoder looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_scene import (
    FRONT,
    Stage,
    analytic_scene,
    block,
    drive_of,
    empty,
    ground,
    renderer_of,
    sphere,
    still,
    union,
    wall,
)
from whole_drive import bound_to

from unisim_blender.core.errors import SceneError
from unisim_blender.core.geometry import FloatArray, Trajectory, make_pose, quaternion_from_yaw, transform_points
from unisim_blender.core.model.decode import CameraDecoder
from unisim_blender.core.presets import preset
from unisim_blender.core.render.quality import QUALITIES
from unisim_blender.core.render.tracers.torch import tracer as torch_tracer
from unisim_blender.core.sensors.bounds import BIN_S, Bounds
from unisim_blender.core.sensors.camera import camera_rays, pixel_grid
from unisim_blender.core.sensors.frames import CAMERA_PASSES, RenderStats
from unisim_blender.core.sensors.lidar import lidar_rays
from unisim_blender.core.sensors.rays import Rays
from unisim_blender.core.training.export import observe
from unisim_blender.core.world.drive import (
    Actor,
    Appearance,
    Box,
    Camera,
    CameraModel,
    Drive,
    Lidar,
    RollingShutter,
    StaticCopy,
)

LEVEL = np.array([1.0, 0, 0, 0])
SIZE = np.array([4.0, 2.0, 2.0])


def with_camera(drive: Drive, model: CameraModel, trajectory: Trajectory | None = None) -> Drive:
    camera = drive.cameras["front"]
    return replace(
        drive, cameras={"front": Camera("front", model, trajectory or camera.world_from_camera, camera.time_s)}
    )


def car_before_a_wall() -> Stage:
    """Ground, a wall at x = 10, a car at (0, 0)."""
    scene = analytic_scene(union(ground, wall(10.0)), {"car": (block([3.6, 1.8, 1.6]), SIZE)})
    return Stage(scene, drive_of([still("car", [0, 0, 1.0], SIZE)]))


@pytest.fixture(scope="module")
def stage() -> Stage:
    return car_before_a_wall()


def rays_of(drive: Drive, up: int = 2) -> Rays:
    camera = drive.cameras["front"]
    return camera_rays(camera, camera.time_s[0], *pixel_grid(camera.model, up))


def test_every_pass_of_an_image(stage: Stage) -> None:
    frame = renderer_of(stage.as_scene(), stage.drive, "reference").camera("front", 0, CAMERA_PASSES)
    assert frame.depth_m is not None and frame.z_depth_m is not None and frame.normal is not None
    assert frame.instance is not None and frame.opacity is not None and frame.unsupported is not None
    assert (
        frame.rgb.shape == (32, 48, 3)
        and frame.rgb.dtype == np.float32
        and 0 <= frame.rgb.min() <= frame.rgb.max() <= 1
    )
    rays = rays_of(stage.drive)
    d = np.repeat(np.repeat(rays.directions, 2, 0), 2, 1)
    with np.errstate(divide="ignore"):
        plane = np.where(d[..., 2] < 0, -1.6 / d[..., 2], np.inf)
    wall_m = 30 / d[..., 0]
    road, back = (plane < wall_m - 1) & (frame.instance == 0), (plane > wall_m + 1) & (frame.instance == 0)
    # the part of the wall that lies inside the volume
    back &= (np.abs(d[..., 1] * wall_m) < 8) & (d[..., 2] * wall_m < 9)
    front = frame.instance == 1
    assert road.sum() > 200 and back.sum() > 200 and front.sum() >= 12 and frame.instances == ("car",)
    np.testing.assert_allclose(np.median(frame.depth_m[road] / plane[road]), 1, atol=2e-3)
    np.testing.assert_allclose(frame.depth_m[back], wall_m[back], rtol=3e-3)
    np.testing.assert_allclose(frame.depth_m[front & (d[..., 2] > -0.05)], 18.2, atol=0.2)
    finite = np.isfinite(frame.depth_m)
    np.testing.assert_allclose(frame.z_depth_m[finite], (frame.depth_m * d[..., 0])[finite], rtol=1e-5)
    assert np.quantile(frame.normal[road] @ [0, 0, 1], 0.05) > 0.99
    assert np.quantile(frame.normal[back] @ [-1, 0, 0], 0.05) > 0.99
    assert np.median(frame.normal[front] @ [-1, 0, 0]) > 0.9 and (frame.normal[front] @ [-1, 0, 0]).max() > 0.99
    assert frame.opacity[road | back].min() > 0.98
    # nothing was ever observed but actors, which are always supported
    assert frame.unsupported[road].all() and not frame.unsupported[front].any()


def test_no_pass_is_made_that_was_not_asked_for(stage: Stage) -> None:
    renderer = renderer_of(stage.as_scene(), stage.drive)
    plain, whole = renderer.camera("front", 0), renderer.camera("front", 0, CAMERA_PASSES)
    assert plain.depth_m is None and plain.normal is None and plain.instance is None and plain.unsupported is None
    np.testing.assert_array_equal(plain.rgb, whole.rgb)


def test_where_nothing_is_hit() -> None:
    stage = Stage(analytic_scene(sphere([0.0, 0, 1.6], 1.5), {}), drive_of([]))
    frame = renderer_of(stage.as_scene(), stage.drive).camera("front", 0, CAMERA_PASSES)
    assert frame.depth_m is not None and frame.normal is not None and frame.z_depth_m is not None
    sky = np.isinf(frame.depth_m)
    assert 0.5 < sky.mean() < 1 and np.isinf(frame.z_depth_m[sky]).all() and (frame.normal[sky] == 0).all()
    np.testing.assert_allclose(np.linalg.norm(frame.normal[~sky], axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("turn", (0.0, 1.0))
def test_normals_of_a_turned_copy(turn: float) -> None:
    source = Box(make_pose(np.array([0.0, 12.0, 1.0]), LEVEL), np.array([2.4, 2.4, 2.4]))
    target = make_pose(np.array([-8.0, 0.0, 1.6]), quaternion_from_yaw(np.pi + turn))
    scene = analytic_scene(lambda x: block([1.6, 1.6, 1.6])(x - torch.tensor([0, 12.0, 1.0])), {})
    drive = drive_of([], copies=(StaticCopy("copy", source, target),))
    frame = renderer_of(Stage(scene, drive).as_scene(), drive, "reference").camera("front", 0, ("rgb", "normal"))
    assert frame.normal is not None
    normals = frame.normal[np.linalg.norm(frame.normal, axis=-1) > 0.5]
    facing = target[:3, :3] @ np.eye(3)
    faces = np.abs(normals @ facing).max(1)
    assert len(normals) >= 12 and np.median(faces) > 0.995
    expected = (facing * np.sign(-facing[0])).T
    expected = expected[np.abs(expected[:, 0]) > 0.1]
    assert np.median((normals @ expected.T).max(1)) > 0.995


@pytest.mark.parametrize(("width", "height"), ((47, 31), (48, 32), (1, 1), (3, 64)))
def test_sizes_that_do_not_divide(stage: Stage, width: int, height: int) -> None:
    drive = with_camera(stage.drive, CameraModel(width, height, 40.0, 40.0, width / 2, height / 2))
    frame = renderer_of(stage.as_scene(), drive).camera("front", 0, CAMERA_PASSES)
    assert frame.rgb.shape == (height, width, 3)
    for name in ("depth_m", "z_depth_m", "instance", "opacity", "unsupported"):
        assert getattr(frame, name).shape == (height, width), name


def test_another_width(stage: Stage) -> None:
    frame = renderer_of(stage.as_scene(), stage.drive).camera("front", 0, width=24)
    assert frame.rgb.shape == (16, 24, 3) and frame.model == stage.drive.cameras["front"].model.resized(24)


def test_chunks_change_nothing(stage: Stage, monkeypatch: pytest.MonkeyPatch) -> None:
    renderer = renderer_of(stage.as_scene(), stage.drive)
    whole = renderer.camera("front", 0, CAMERA_PASSES)
    monkeypatch.setattr(torch_tracer, "CHUNK_RAYS", 77)
    parts = renderer.camera("front", 0, CAMERA_PASSES)
    assert whole.depth_m is not None and parts.depth_m is not None
    np.testing.assert_allclose(parts.rgb, whole.rgb, atol=1e-5)
    np.testing.assert_allclose(parts.depth_m, whole.depth_m, rtol=1e-5)
    assert parts.stats.samples_spent == whole.stats.samples_spent and parts.stats.rays == whole.stats.rays == 16 * 24


def test_equal_frames_have_equal_bytes(stage: Stage) -> None:
    frames = [
        renderer_of(car_before_a_wall().as_scene(), stage.drive).camera("front", 0, CAMERA_PASSES) for _ in range(2)
    ]
    for name in ("rgb", "depth_m", "normal", "instance", "opacity", "unsupported"):
        assert getattr(frames[0], name).tobytes() == getattr(frames[1], name).tobytes(), name


def test_qualities_spend_more(stage: Stage) -> None:
    spent = [renderer_of(stage.as_scene(), stage.drive, q).camera("front", 0).stats.samples_spent for q in QUALITIES]
    assert spent == sorted(spent) and spent[0] < spent[1] < spent[2]


def random_actors(n: int, rng: np.random.Generator) -> list[Actor]:
    actors = []
    for i in range(n):
        keys = np.array([0.0, 0.2, 0.5])
        positions = rng.uniform([-60, -60, 0], [60, 60, 3]) + np.cumsum(rng.normal(0, 4, (3, 3)), 0)
        trajectory = Trajectory(keys, positions, quaternion_from_yaw(rng.uniform(-3, 3, 3)))
        start, end = np.sort(rng.uniform(-0.1, 0.6, 2))
        uid = f"a{i:03}"
        actors.append(
            Actor(
                uid,
                "Car",
                rng.choice([4.0, 40.0]) * rng.uniform(0.1, 1, 3),
                trajectory,
                start,
                end,
                True,
                Appearance("car"),
            )
        )
    return actors


def test_no_actor_is_skipped_that_a_ray_meets() -> None:
    """Against every box tried on every ray, for moving cameras of all kinds, and a LiDAR that looks all round."""
    rng = np.random.default_rng(11)
    scene = analytic_scene(empty, {"car": (empty, SIZE)})
    drive = drive_of(random_actors(60, rng))
    skipped = hit = 0
    for _ in range(40):
        focal = float(rng.choice([4.0, 20.0, 40.0, 400.0]))
        shutter = RollingShutter(float(rng.choice([0.0, 0.03, -0.1])), 0.5)
        model = CameraModel(24, 16, focal, focal, rng.uniform(0, 24), rng.uniform(0, 16), shutter)
        turn = make_pose(np.zeros(3), quaternion_from_yaw(rng.uniform(-3, 3)))
        pose = turn @ make_pose(np.zeros(3), FRONT)
        start = rng.uniform([-60, -60, 1], [60, 60, 3])
        poses = np.stack([pose, pose])
        poses[:, :3, 3] = start, start + rng.normal(0, 5, 3)
        camera = Camera("front", model, Trajectory.from_poses(np.array([0.0, 0.5]), poses), drive.time_s)
        bundles = [camera_rays(camera, camera.time_s[int(rng.integers(6))], *pixel_grid(model)).flat()]
        lidar = replace(drive.lidars["top"], world_from_lidar=Trajectory.from_poses(np.array([0.0, 0.5]), poses))
        bundles.append(lidar_rays(lidar, lidar.time_s[int(rng.integers(6))]).flat())
        tracer = bound_to(torch_tracer.TorchBackend(Stage(scene, drive).as_scene()), drive)
        for rays in bundles:
            among = tracer.bounds.in_reach(rays)
            tracer.trace(rays, set(), True, None, stats := RenderStats())
            assert stats.actors_skipped == 60 - len(among)
            batch = torch_tracer.to_batch(rays, scene.frame)
            hits = tracer.tensors.own.tracklets.hits(batch.origins, batch.directions, batch.time_s, 0.5)
            assert set(hits.actor.tolist()) <= set(among)
            skipped, hit = skipped + stats.actors_skipped, hit + len(hits.ray)
    assert skipped > 1000 and hit > 1000


def test_rows_of_a_rolling_shutter_see_a_moving_actor_at_different_places() -> None:
    """A tall bar that crosses the view at 20 m/s leans by its speed times the time of readout."""
    bar = np.array([0.6, 0.6, 8.0])
    trajectory = Trajectory(
        np.array([-1.0, 1.0]), np.array([[-10.0, -20, 1.6], [-10, 20, 1.6]]), np.tile(LEVEL, (2, 1))
    )
    actor = still("bar", [0, 0, 0], bar, world_from_actor=trajectory, is_moving=True)
    scene = analytic_scene(empty, {"bar": (block([0.5, 0.5, 8.0]), bar)})
    columns = []
    for duration in (0.0, 0.05, -0.05):
        model = CameraModel(96, 64, 80.0, 80.0, 48.0, 32.0, RollingShutter(duration, 0.5))
        drive = with_camera(drive_of([actor]), model)
        frame = renderer_of(Stage(scene, drive).as_scene(), drive).camera("front", 0, ("rgb", "instance"))
        assert frame.instance is not None
        rows = frame.instance == 1
        assert rows.any(1).all(), "the bar crosses every row"
        columns.append((rows * np.arange(96)).sum(1) / rows.sum(1))
    lean = [c[-8:].mean() - c[:8].mean() for c in columns]
    # 56 of 64 rows lie between; image columns grow to the right, to -y
    expected = -20 * 0.05 * 56 / 64 / 9.75 * 80
    assert lean[0] == pytest.approx(0, abs=0.3)
    assert lean[1] == pytest.approx(expected, abs=1.0) and lean[2] == pytest.approx(-expected, abs=1.0)


def test_a_sweep(stage: Stage) -> None:
    with torch.no_grad():
        # every ray returns
        stage.scene.get_parameter("lidar_head.network.4.bias")[1] = 100.0
    blocked = np.zeros((4, 180), bool)
    blocked[2, 90:] = True
    lidar = stage.drive.lidars["top"]
    near = Lidar("top", replace(lidar.model, max_range_m=20.0), lidar.world_from_lidar, lidar.time_s, blocked)
    drive = replace(stage.drive, lidars={"top": near})
    sweep = renderer_of(stage.as_scene(), drive, "reference").lidar("top", 2)
    assert sweep.depth_m.shape == sweep.returned.shape == (4, 180) and sweep.instances == ("car",)
    d = sweep.directions
    assert not sweep.returned[blocked].any() and not sweep.returned[sweep.depth_m > 20].any()
    road = sweep.returned & (sweep.instance == 0) & (d[..., 2] < -0.1)
    assert road.sum() > 100
    np.testing.assert_allclose(np.median(sweep.depth_m[road]), 1.6 / np.sin(np.radians(8)), rtol=0.01)
    # the upper beam meets nothing but the wall, which is out of range
    assert not sweep.returned[0].any() and (sweep.instance[1] == 1).any()
    assert sweep.intensity.min() >= 0 and sweep.intensity.max() <= 1
    away = sweep.return_probability[0][d[0, :, 0] < 0]
    assert (away == 0).all(), "what meets nothing returns nothing"


def test_drawn_returns_follow_their_probability(stage: Stage) -> None:
    with torch.no_grad():
        stage.scene.get_parameter("lidar_head.network.4.weight")[1] = 0.0
        stage.scene.get_parameter("lidar_head.network.4.bias")[1] = -1.0
    settled = renderer_of(stage.as_scene(), stage.drive).lidar("top", 2)
    assert not settled.returned.any() and settled.return_probability.max() == pytest.approx(0.2689, abs=1e-3)
    drawn = [renderer_of(stage.as_scene(), stage.drive, draw=seed).lidar("top", 2).returned for seed in (1, 1, 2)]
    meets = settled.return_probability > 0
    assert drawn[0][meets].mean() == pytest.approx(0.2689, abs=0.08) and not drawn[0][~meets].any()
    np.testing.assert_array_equal(drawn[0], drawn[1])
    assert (drawn[0] != drawn[2]).any()


def foreign_stage(features: int, upsample: int) -> Stage:
    config = replace(preset("tiny").model, features=features, upsample=upsample)
    other = analytic_scene(empty, {"car": (block([3.6, 1.8, 1.6]), SIZE)}, config)
    drive = drive_of([still("new", [-6, 1.5, 1.6], SIZE, appearance=Appearance("car", "elsewhere"))])
    return Stage(analytic_scene(union(ground, wall(10.0)), {}), drive, {"elsewhere": other})


@pytest.mark.parametrize(("features", "upsample"), ((15, 2), (7, 3)))
def test_a_foreign_actor_is_laid_over_the_image(features: int, upsample: int) -> None:
    stage = foreign_stage(features, upsample)
    others = {"elsewhere": Stage(stage.others["elsewhere"], drive_of([])).as_scene("elsewhere")}
    frame = renderer_of(stage.as_scene(), stage.drive, others=others).camera("front", 0, CAMERA_PASSES)
    bare = renderer_of(stage.as_scene(), drive_of([])).camera("front", 0, CAMERA_PASSES)
    assert frame.instance is not None and frame.instances == ("new",)
    there = frame.instance == 1
    assert there.sum() > 20
    rows, columns = np.nonzero(there)
    reach = 2 * (stage.scene.camera_decoder.reach + 1)
    clear = np.ones_like(there)
    clear[max(0, rows.min() - reach) : rows.max() + reach, max(0, columns.min() - reach) : columns.max() + reach] = (
        False
    )
    assert clear.sum() > 100
    np.testing.assert_allclose(frame.rgb[clear], bare.rgb[clear], atol=1e-6)
    assert np.abs(frame.rgb - bare.rgb)[there].mean() > 1e-4


def test_a_foreign_actor_in_a_sweep() -> None:
    stage = foreign_stage(7, 3)
    others = {"elsewhere": Stage(stage.others["elsewhere"], drive_of([])).as_scene("elsewhere")}
    sweep = renderer_of(stage.as_scene(), stage.drive, others=others).lidar("top", 0)
    hit = sweep.instance == 1
    assert hit.sum() > 3 and np.isfinite(sweep.intensity).all()
    points = sweep.origins[hit] + sweep.directions[hit] * sweep.depth_m[hit][:, None]
    np.testing.assert_allclose(np.median(points[:, 0]), -6 - 1.8, atol=0.1)


def test_a_foreign_actor_answers_a_lidar_as_in_its_own_scene() -> None:
    stage = foreign_stage(7, 3)
    home = drive_of([replace(stage.drive.actors["new"], appearance=Appearance("car"))])
    other = Stage(stage.others["elsewhere"], home).as_scene("elsewhere")
    there = renderer_of(other, home).lidar("top", 0)
    here = renderer_of(stage.as_scene(), stage.drive, others={"elsewhere": other}).lidar("top", 0)
    hit = (here.instance == 1) & (there.instance == 1)
    assert hit.sum() > 3
    # at its edges the wall behind has its share
    for name in ("depth_m", "intensity", "return_probability"):
        difference = np.abs(getattr(here, name)[hit] - getattr(there, name)[hit])
        assert np.quantile(difference, 0.7) < 1e-4, name


def test_what_the_recording_saw(stage: Stage) -> None:
    scene = car_before_a_wall().as_scene()
    observe(scene, ["front"], [0], [])
    frame = renderer_of(scene, stage.drive).camera("front", 0, ("rgb", "unsupported", "depth"))
    assert frame.unsupported is not None and frame.depth_m is not None
    # further on, rows of one image lie voxels apart on the road
    assert frame.unsupported[frame.depth_m < 12].mean() < 0.02 and frame.unsupported[:16].mean() < 0.02
    back = replace(stage.drive.cameras["front"], world_from_camera=Trajectory.from_poses(np.zeros(1), BACK[None]))
    behind = renderer_of(scene, replace(stage.drive, cameras={"front": back})).camera(
        "front", 0, ("rgb", "unsupported", "depth")
    )
    assert behind.unsupported is not None and behind.depth_m is not None
    assert behind.unsupported[np.isfinite(behind.depth_m)].mean() > 0.8


BACK = make_pose(np.array([-20.0, 0, 1.6]), quaternion_from_yaw(np.pi)) @ make_pose(np.zeros(3), FRONT)


def test_lidar_returns_count_as_seen() -> None:
    scene = car_before_a_wall().as_scene()
    point = np.array([[3.0, 4.0, 0.1]])
    observe(scene, [], [], [point])
    assert int(scene.model.observed.sum()) == 27, "its voxel and those round it"
    cell = torch.nonzero(scene.model.observed).float().mean(0)
    x = transform_points(np.linalg.inv(scene.model.volume.world_from_volume), point)[0]
    np.testing.assert_array_equal(cell.numpy(), np.floor(x / 0.5))


def test_errors_name_what_is_wrong(stage: Stage) -> None:
    with pytest.raises(SceneError, match="no quality 'superb': there are fast, balanced, fine, reference"):
        renderer_of(stage.as_scene(), stage.drive, "superb")
    renderer = renderer_of(stage.as_scene(), stage.drive)
    with pytest.raises(SceneError, match="no camera 'rear'"):
        renderer.camera("rear", 0)
    with pytest.raises(SceneError, match="no LiDAR 'rear'"):
        renderer.lidar("rear", 0)


@pytest.mark.parametrize(("blocks", "kernel", "up"), ((1, 3, 2), (2, 3, 1), (1, 7, 3), (2, 1, 1), (1, 1, 3)))
def test_an_output_pixel_depends_on_no_cell_beyond_the_decoders_reach(blocks: int, kernel: int, up: int) -> None:
    config = replace(preset("tiny").model, decoder_blocks=blocks, decoder_kernel=kernel, upsample=up)
    torch.manual_seed(3)
    decoder = CameraDecoder(config).eval()
    features = torch.randn(1, config.decoder_channels, 25, 31)
    changed = features.clone()
    row, column = 11, 17
    changed[..., row, column] += 3.0
    with torch.no_grad():
        before, after = decoder(features), decoder(changed)
    assert before.shape == (1, 3, 25 * up, 31 * up)
    differs = (before != after).any(1)[0].numpy()
    cells = differs.reshape(25, up, 31, up).any((1, 3))
    distance = np.maximum(np.abs(np.arange(25) - row)[:, None], np.abs(np.arange(31) - column)[None])
    assert not cells[distance > decoder.reach].any()
    assert cells[distance == decoder.reach].any(), "and no less far than it says"


def test_bounds_hold_an_actor_all_the_time() -> None:
    rng = np.random.default_rng(5)
    actors = random_actors(10, rng)
    bounds = Bounds(actors)
    for i, actor in enumerate(actors):
        for time in np.linspace(actor.start_s, actor.end_s, 23):
            at = min(int((time - bounds.first_s) // BIN_S), len(bounds.radii) - 1)
            corner: FloatArray = actor.world_from_actor.at(time)[:3, 3]
            reach = np.linalg.norm(corner - bounds.centres[at, i]) + np.linalg.norm(actor.size_m) / 2
            assert reach <= bounds.radii[at, i]
