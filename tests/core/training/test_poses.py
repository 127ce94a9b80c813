"""Poses that training corrects: boxes disturbed by noise, of which training takes back what it can; corrections of cameras,
with which training and the finished scene see along the same rays; and trajectories without their labels' noise, against
a smoothing spline of SciPy's, and where the noise is known."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.interpolate import make_smoothing_spline
from small_log import small_drive, write_small_log
from turning_drive import turning_drive

from unisim_blender.core.cli.main import run
from unisim_blender.core.evaluation.tracklets import offset_errors, taken_back
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import (
    FloatArray,
    Trajectory,
    make_pose,
    matrix_from_quaternion,
    quaternion_from_yaw,
    quaternion_product,
)
from unisim_blender.core.ops.ray_segments import RayBatch
from unisim_blender.core.sensors.camera import along_axis, camera_rays, distinct, pixel_grid
from unisim_blender.core.training.batches.sweeps import ray_batch
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.export import refined_drive
from unisim_blender.core.training.poses import (
    FEWEST_KEYS,
    MOST_KEYS,
    CameraPoses,
    _pieces,
    disturbed,
    fitted,
    fitted_trajectory,
    smoothing,
    with_drive,
)
from unisim_blender.core.training.trainer import Trainer
from unisim_blender.core.world.drive import Actor, Drive, RollingShutter

KEYS = 4


def poses(x: list[float], yaw_deg: list[float]) -> FloatArray:
    """Poses at (x, 0, 0), turned about z."""
    positions = np.stack([np.array(x), np.zeros(len(x)), np.zeros(len(x))], -1)
    return make_pose(positions, quaternion_from_yaw(np.radians(yaw_deg)))


def on(path: FloatArray, moving: bool = True) -> Actor:
    trajectory = Trajectory.from_poses(0.1 * np.arange(len(path)), path)
    return replace(small_drive().actors["car-1"], world_from_actor=trajectory, is_moving=moving)


def test_a_constant_offset_in_the_box_is_no_error() -> None:
    true = poses([0, 1, 2, 3], [0, 30, 60, 90])
    offset = make_pose(np.array([0.3, -0.2, 0.1]), quaternion_from_yaw(0.2))
    shift_m, turn_rad = offset_errors(true, true @ offset)
    np.testing.assert_allclose(shift_m, 0, atol=1e-12)
    np.testing.assert_allclose(turn_rad, 0, atol=1e-7)
    # in the world's axes the same shift is none that an appearance in the box could make up for
    shift_m, _ = offset_errors(true, make_pose(np.array([0.3, 0.0, 0.0]), np.array([1.0, 0, 0, 0])) @ true)
    mean = 0.3 * np.mean([[np.cos(a), -np.sin(a)] for a in np.radians([0, 30, 60, 90])], 0)
    np.testing.assert_allclose(shift_m[0], np.hypot(0.3 - mean[0], mean[1]), atol=1e-12)


def test_errors_are_what_the_mean_leaves() -> None:
    """Shifts of 0, 0.4, 0, 0.4 m are 0.2 m about their mean; turns of 3, -3, 3, -3 degrees are 3 about theirs."""
    true = poses([0, 5, 10, 15], [0, 0, 0, 0])
    shift_m, turn_rad = offset_errors(true, poses([0, 5.4, 10, 15.4], [3, -3, 3, -3]))
    np.testing.assert_allclose(shift_m, 0.2, atol=1e-12)
    np.testing.assert_allclose(np.degrees(turn_rad), 3, atol=1e-9)


def test_what_is_taken_back() -> None:
    """From 0.2 m and 3 degrees to 0.05 m and 0.6: three quarters and four fifths."""
    true = on(poses([0, 5, 10, 15], [0, 0, 0, 0]))
    before = on(poses([0, 5.4, 10, 15.4], [3, -3, 3, -3]))
    after = on(poses([1, 6.1, 11, 16.1], [0.6, -0.6, 0.6, -0.6]))
    still = replace(true, is_moving=False)
    found = taken_back({"a": true, "b": still}, {"a": before, "b": still}, {"a": after, "b": still})
    assert found is not None and found["actors"] == 1
    expected = {
        "disturbed_m": 0.2, "refined_m": 0.05, "shift_taken_back": 0.75,
        "disturbed_deg": 3.0, "refined_deg": 0.6, "turn_taken_back": 0.8,
    }  # fmt: skip
    for name, value in expected.items():
        assert found[name] == pytest.approx(value, abs=1e-7), name
    same = taken_back({"a": true}, {"a": before}, {"a": before})
    assert same is not None and same["shift_taken_back"] == 0.0 and same["turn_taken_back"] == 0.0
    assert taken_back({"b": still}, {"b": still}, {"b": still}) is None


def test_noise_is_each_frames_own_and_known() -> None:
    drive = small_drive()
    path = Trajectory(np.arange(4000.0), np.zeros((4000, 3)), np.tile([1.0, 0, 0, 0], (4000, 1)))
    long = replace(drive, actors={**drive.actors, "car-1": replace(drive.actors["car-1"], world_from_actor=path)})
    noisy = disturbed(long, 0.3, 3.0, 7)
    moved = noisy.actors["car-1"].world_from_actor
    shift, yaw = moved.positions, np.degrees(2 * np.arctan2(moved.quaternions_wxyz[:, 3], moved.quaternions_wxyz[:, 0]))
    np.testing.assert_allclose(shift[:, :2].std(0), 0.3, rtol=0.04)
    assert not shift[:, 2].any() and abs(np.corrcoef(shift[1:, 0], shift[:-1, 0])[0, 1]) < 0.05
    np.testing.assert_allclose(yaw.std(), 3.0, rtol=0.04)
    np.testing.assert_array_equal(
        disturbed(long, 0.3, 3.0, 7).actors["car-1"].world_from_actor.positions, moved.positions
    )
    assert not np.array_equal(disturbed(long, 0.3, 3.0, 8).actors["car-1"].world_from_actor.positions, moved.positions)
    for uid in ("van", "cone"):
        assert noisy.actors[uid] is long.actors[uid], "what stands still is left alone"
    assert list(noisy.actors) == list(long.actors)


def test_training_on_disturbed_boxes_tells_of_them(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log, scene = tmp_path / "log", tmp_path / "scene"
    write_small_log(log)
    options = ["--preset", "tiny", "--iterations", "1", "--frames", "0:2", "--quiet", "--disturb", "0.3", "3"]
    assert run(["train", str(log), "--out", str(scene), *options]) == 0
    said = capsys.readouterr().out
    assert "boxes of 1 moving actors were off by 0." in said and "0 % and 0 % taken back" in said.replace("-0", "0")
    training = json.loads((scene / "scene.json").read_text())["training"]
    assert training["disturbed"] == {"metres": 0.3, "degrees": 3.0}
    assert run(["eval", str(scene), str(log), "--out", str(tmp_path / "eval"), "--frames", "3"]) == 0
    metrics = json.loads((tmp_path / "eval/metrics.json").read_text())["tracklets"]
    assert metrics["actors"] == 1 and 0.05 < metrics["disturbed_m"] < 0.8
    assert metrics["refined_m"] == pytest.approx(metrics["disturbed_m"], abs=1e-3)


def test_the_finished_camera_sees_along_the_rays_that_training_saw_along() -> None:
    recorded = turning_drive().cameras["front"]
    # rows at other times than the image's would see the poses between two keys
    camera = replace(recorded, model=replace(recorded.model, shutter=RollingShutter()))
    frames = sorted(camera.time_s)[::2]
    poses = CameraPoses([np.array([camera.time_s[f] for f in frames])])
    generator = torch.Generator().manual_seed(0)
    with torch.no_grad():
        poses.shift_m.copy_(0.05 * torch.randn(poses.shift_m.shape, generator=generator))
        poses.turn_rad.copy_(0.002 * torch.randn(poses.turn_rad.shape, generator=generator))
    after = poses.corrected(camera, 0)
    for frame in frames:
        u, v = np.array([0.5, 3.5, 7.5]), np.array([0.5, 2.5, 1.5])
        before, wanted = (camera_rays(one, camera.time_s[frame], u, v) for one in (camera, after))
        rotation = camera.world_from_camera.at(camera.time_s[frame])[:3, :3]
        rays = ray_batch(before.origins, before.directions, before.time_s)
        got = poses(rays, torch.zeros(1, dtype=torch.long), torch.as_tensor(rotation)[None], learn=True)
        assert np.abs(got.origins.detach().numpy() - wanted.origins).max() < 1e-5
        assert np.abs(got.directions.detach().numpy() - wanted.directions).max() < 1e-5


def test_a_frame_between_two_is_corrected_as_both_are() -> None:
    poses = CameraPoses([np.array([0.0, 0.2, 0.4]), np.array([0.1])])
    with torch.no_grad():
        poses.turn_rad[0, :, 0] = torch.tensor([0.0, 1e-3, 3e-3])
        poses.shift_m[1, 0] = torch.tensor([1.0, 2.0, 3.0])
    camera, time = torch.tensor([0, 0, 1, 1, 0]), torch.tensor([0.3, 0.2, 0.1, 9.0, -50.0], dtype=torch.float64)
    shift, turn = poses.at(camera, time)
    turn[0].sum().backward()
    shift, turn = shift.detach(), turn.detach()
    assert abs(float(turn[0, 0]) - 2e-3) < 2e-4
    assert abs(float(turn[1, 0]) - 1e-3) < 4e-4
    assert torch.equal(shift[2:4], torch.tensor([[1.0, 2.0, 3.0]] * 2)), "a camera of one image is corrected as a whole"
    assert float(turn[4, 0]) == 0, "long before the first image it is as in the first"
    grad = poses.turn_rad.grad
    assert grad is not None and float(grad[0, 1, 0]) > 0.4 and float(grad[0, 2, 0]) > 0.4


def test_no_gradient_where_cameras_do_not_learn() -> None:
    poses = CameraPoses([np.array([0.0, 0.1])])
    rays = RayBatch(torch.zeros(2, 3), torch.eye(3)[:2], torch.zeros(2, dtype=torch.float64))
    pose = torch.eye(3)[None]
    assert not poses(rays, torch.zeros(1, dtype=torch.long), pose, learn=False).directions.requires_grad
    assert poses(rays, torch.zeros(1, dtype=torch.long), pose, learn=True).directions.requires_grad


@pytest.mark.parametrize("shutter", (RollingShutter(), RollingShutter(0.03, 0.4)))
def test_rays_are_pixels_directions_turned_by_their_rows_poses(shutter: RollingShutter) -> None:
    recorded = turning_drive().cameras["front"]
    camera = replace(recorded, model=replace(recorded.model, shutter=shutter))
    time_s = sorted(camera.time_s.values())[1]
    u, v = pixel_grid(camera.model)
    rays = camera_rays(camera, time_s, u, v)
    local = np.stack(
        [(u - camera.model.cx) / camera.model.fx, (v - camera.model.cy) / camera.model.fy, np.ones_like(u)], -1
    )
    local /= np.linalg.norm(local, axis=-1, keepdims=True)
    times = time_s + shutter.duration_s * (v / camera.model.height - shutter.reference)
    poses = camera.world_from_camera.at(times.reshape(-1)).reshape(*v.shape, 4, 4)
    assert np.abs(poses[0, 0] - poses[-1, 0]).max() > 1e-3 or not shutter.duration_s
    assert np.array_equal(rays.time_s, times) and np.array_equal(rays.origins, poses[..., :3, 3])
    assert np.abs(rays.directions - np.einsum("...ij,...j->...i", poses[..., :3, :3], local)).max() < 1e-15
    # rays drawn one by one are the grid's, to the bit
    some = np.random.default_rng(0).integers(0, v.size, 50)
    alone = camera_rays(camera, time_s, u.reshape(-1)[some], v.reshape(-1)[some])
    assert np.array_equal(alone.directions, rays.directions.reshape(-1, 3)[some])
    axis = camera.world_from_camera.at(time_s)[:3, 2]
    assert np.abs(along_axis(camera, time_s, u[:1], v[:, :1]) - rays.directions @ axis).max() < 1e-15


@pytest.mark.parametrize(
    "values", ([0.5, 3.5, 0.5, 2.5], [0.5, 0.75, 0.5], [7.0], [], [1e9, 1.0, 1e9], [0.1, 1.1, 2.1, 0.1], [np.nan, 1.0])
)
def test_distinct_values_are_those_that_sorting_finds(values: list[float]) -> None:
    found, which = distinct(np.array(values))
    wanted = np.unique(np.array(values), return_inverse=True)
    assert np.array_equal(found, wanted[0], equal_nan=True) and np.array_equal(which, wanted[1])


def uneven(n: int, seed: int) -> FloatArray:
    return 3.0 + np.cumsum(np.random.default_rng(seed).uniform(0.05, 0.25, n))


def course(name: str, t: FloatArray) -> FloatArray:
    """Positions (T, 2) of a car at 12 m/s or so."""
    s, middle = t - t[0], (t[-1] - t[0]) / 2
    x, y = {
        "straight": (12 * s, 0 * s),
        "stands": (0 * s, 0 * s),
        "brakes": (12 * s - 1.5 * s**2, 0 * s),
        "brakes to a stop": (np.where(s < middle, 6 * middle * s - 3 * s**2, 3 * middle**2), 0 * s),
        "turns": (30 * np.sin(0.4 * s), 30 - 30 * np.cos(0.4 * s)),
        "changes lanes": (12 * s, 1.75 * (1 - np.cos(np.pi * s / s[-1]))),
        "swerves": (12 * s, np.maximum(s - middle, 0)),
    }[name]
    return np.stack([x + 200, y - 70], -1)


COURSES = ("straight", "stands", "brakes", "brakes to a stop", "turns", "changes lanes", "swerves")


@pytest.mark.parametrize("spread", (0.03, 0.3))
def test_it_is_the_smoothing_spline_of_the_likeliest_strength(spread: float) -> None:
    """SciPy's spline for each strength, and the likelihood of every combination of keys that no straight
    line has a part in."""
    t = uneven(14, 1)
    noise = np.random.default_rng(2).normal(0, spread, (14, 2))
    values = course("turns", t) + noise
    best, expected = np.inf, values
    for strength in 10.0 ** np.linspace(-9, 7, 161):
        hat = np.stack([make_smoothing_spline(t, unit, lam=strength)(t) for unit in np.eye(14)], -1)
        rest = np.linalg.eigvalsh(np.eye(14) - (hat + hat.T) / 2)[2:]
        squares = np.einsum("kc,kl,lc->", values, np.eye(14) - hat, values)
        surprise = np.log(squares) - np.log(rest).mean()
        if surprise < best:
            best, expected = surprise, hat @ values
    found = values + smoothing(t, values)
    assert np.abs(expected - values).max() > spread / 2
    np.testing.assert_allclose(found, expected, atol=2e-4 * spread)


@pytest.mark.parametrize("keys", (FEWEST_KEYS, 20, 80))
@pytest.mark.parametrize("name", COURSES)
def test_a_way_without_noise_is_left_where_it_is(name: str, keys: int) -> None:
    """To a millimetre, which is what labels are rounded to, at even times and at uneven ones."""
    for t in (0.1 * np.arange(keys), uneven(keys, keys)):
        for trajectory in (course(name, t), course(name, t).round(3)):
            assert np.abs(smoothing(t, trajectory)).max() < 1e-3


@pytest.mark.parametrize("name", COURSES)
def test_a_noisy_way_loses_most_of_its_noise(name: str) -> None:
    """Of noise of 0.3 m in each of 40 keys' coordinates more than half is gone, the square root of the mean taken."""
    t = 0.1 * np.arange(40)
    rng, left = np.random.default_rng(5), []
    for _ in range(12):
        noise = rng.normal(0, 0.3, (40, 2))
        left.append(noise + smoothing(t, course(name, t) + noise))
    assert np.sqrt(np.mean(np.square(left))) < 0.3 * 0.45


def actor_on(trajectory: Trajectory, moving: bool = True) -> Actor:
    return replace(small_drive().actors["car-1"], world_from_actor=trajectory, is_moving=moving)


def tilted(t: FloatArray, yaw: FloatArray) -> Trajectory:
    """Round a bend that leads through the heading where an angle leaps, pitched and rolled, with heights of its own."""
    tilt = np.array([0.998, 0.03, -0.05, 0.0]) / np.linalg.norm([0.998, 0.03, -0.05, 0.0])
    positions = np.concatenate([course("turns", t), np.sin(7 * t)[:, None]], -1)
    return Trajectory(t, positions, quaternion_product(quaternion_from_yaw(yaw), np.tile(tilt, (len(t), 1))))


def test_headings_are_smoothed_about_z_and_nothing_else_is() -> None:
    t = uneven(40, 3)
    true = np.pi - 0.8 + 0.4 * (t - t[0])
    noise = np.random.default_rng(4).normal(0, np.radians(3), 40)
    exact, noisy = tilted(t, true), tilted(t, true + noise)
    np.testing.assert_allclose(fitted_trajectory(exact).poses, exact.poses, atol=1e-5)
    found = fitted_trajectory(noisy)
    np.testing.assert_array_equal(found.times_s, t)
    np.testing.assert_array_equal(found.positions[:, 2], noisy.positions[:, 2])
    # what is left of the turn is about the world's z
    between = matrix_from_quaternion(found.quaternions_wxyz) @ np.swapaxes(
        matrix_from_quaternion(exact.quaternions_wxyz), 1, 2
    )
    np.testing.assert_allclose(between[:, 2], np.tile([0.0, 0, 1], (40, 1)), atol=1e-9)
    left = np.arctan2(between[:, 1, 0], between[:, 0, 0])
    assert np.sqrt((left**2).mean()) < np.radians(3) * 0.4


def long_drive(moving: bool = True, keys: int = 30) -> Drive:
    """The small drive with a car that is labelled more often."""
    t = 0.02 * np.arange(keys)
    trajectory = Trajectory(t, np.stack([15 + 8 * t, 0.5 * t**2, 0 * t + 0.8], -1), quaternion_from_yaw(0.1 * t))
    drive = small_drive()
    return replace(drive, actors={**drive.actors, "car-1": actor_on(trajectory, moving)})


def test_who_is_fitted() -> None:
    """Who moves and has keys enough."""
    noisy = disturbed(long_drive(), 0.3, 3.0, 1)
    after = fitted(noisy)
    assert list(after.actors) == list(noisy.actors)
    found = taken_back(long_drive().actors, noisy.actors, after.actors)
    assert found is not None and found["shift_taken_back"] > 0.5 and found["turn_taken_back"] > 0.5
    for uid in ("van", "cone"):
        assert after.actors[uid] is noisy.actors[uid]
    few = disturbed(long_drive(keys=FEWEST_KEYS - 1), 0.3, 3.0, 1)
    assert fitted(few).actors["car-1"] is few.actors["car-1"]
    still = replace(noisy, actors={**noisy.actors, "car-1": replace(noisy.actors["car-1"], is_moving=False)})
    assert fitted(still).actors["car-1"] is still.actors["car-1"]


def test_a_training_starts_from_fitted_trajectories_where_it_refines_them(tmp_path: Path) -> None:
    write_small_log(tmp_path)
    noisy = disturbed(long_drive(), 0.3, 3.0, 1)
    log = with_drive(open_log(tmp_path), noisy)
    config = TrainConfig(("front_camera",), ("pandar64",), (0, 2), preset="tiny", iterations=1)

    def start(without: tuple[str, ...]) -> FloatArray:
        return refined_drive(Trainer(log, replace(config, without=without))).actors["car-1"].world_from_actor.poses

    np.testing.assert_allclose(start(()), fitted(noisy).actors["car-1"].world_from_actor.poses, atol=1e-5)
    np.testing.assert_array_equal(start(("tracklet-refinement",)), noisy.actors["car-1"].world_from_actor.poses)
    assert log.drive is noisy, "the log that was given is left alone"


@pytest.mark.parametrize(
    ("keys", "pieces"), [(FEWEST_KEYS, 1), (MOST_KEYS, 1), (MOST_KEYS + 1, 2), (700, 3), (1000, 4)]
)
def test_pieces_of_a_long_way_count_one_in_all(keys: int, pieces: int) -> None:
    total, reached = np.zeros(keys), np.zeros(keys, int)
    for piece, share in _pieces(keys):
        assert piece.stop - piece.start == min(keys, MOST_KEYS) and (share > 0).all()
        total[piece] += share
        reached[piece] += 1
    np.testing.assert_allclose(total, 1, atol=1e-12)
    assert reached.min() == 1 and len(_pieces(keys)) == pieces


def test_a_long_noisy_way_loses_most_of_its_noise_and_has_no_seams() -> None:
    t = 0.1 * np.arange(1000)
    true = np.stack([12 * t, 8 * np.sin(0.3 * t), 0 * t], -1)
    noise = np.pad(np.random.default_rng(3).normal(0, 0.3, (1000, 2)), ((0, 0), (0, 1)))
    heading = quaternion_from_yaw(np.arctan2(2.4 * np.cos(0.3 * t), 12.0))
    left = fitted_trajectory(Trajectory(t, true + noise, heading)).positions - true
    assert np.sqrt((left[:, :2] ** 2).mean()) < 0.15
    assert np.abs(np.diff(left, 2, axis=0)).max() < 0.02
