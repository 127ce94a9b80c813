"""Trajectories without their labels' noise: against a smoothing spline of SciPy's, and where the noise is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.interpolate import make_smoothing_spline
from small_log import small_drive, write_small_log

from unisim_blender.core.evaluation.tracklets import taken_back
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.geometry import FloatArray, Trajectory, matrix_from_quaternion, quaternion_from_yaw
from unisim_blender.core.scenario.motion.trajectories import quaternion_product
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.export import refined_drive
from unisim_blender.core.training.poses import (
    FEWEST_KEYS,
    MOST_KEYS,
    _pieces,
    disturbed,
    fitted,
    fitted_trajectory,
    smoothing,
    with_drive,
)
from unisim_blender.core.training.trainer import Trainer
from unisim_blender.core.world.drive import Actor, Drive


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
