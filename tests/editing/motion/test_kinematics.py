"""Speed, acceleration and curvature of trajectories whose motion is known, and the limits. No Blender is needed."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray
from unisim_blender.editing.motion.kinematics import Limits, describe, exceeded, is_limited, motion_of, runs, slopes

TIMES = np.arange(0, 4, 0.1)


def straight(along: FloatArray) -> FloatArray:
    """Positions (N, 3) on a line that is along no axis."""
    return along[:, None] * np.array([0.6, 0.8, 0.0]) + np.array([100.0, -40.0, 2.0])


def circle(radius_m: float, speed_m_s: float, times_s: FloatArray = TIMES) -> FloatArray:
    """Positions (N, 3) on a circle that turns left."""
    angles = speed_m_s / radius_m * times_s
    return np.stack([radius_m * np.sin(angles), -radius_m * np.cos(angles), np.zeros_like(angles)], -1)


def test_constant_acceleration() -> None:
    motion = motion_of(straight(3.0 * TIMES + 2.5 * TIMES**2 / 2), TIMES)
    assert motion.speed_m_s == pytest.approx(3.0 + 2.5 * TIMES, abs=1e-6)
    assert motion.acceleration_m_s2 == pytest.approx(np.full(len(TIMES), 2.5), abs=1e-6)
    assert motion.lateral_m_s2 == pytest.approx(np.zeros(len(TIMES)), abs=1e-6)
    assert motion.curvature_1_m == pytest.approx(np.zeros(len(TIMES)), abs=1e-6)


def test_braking_is_negative() -> None:
    motion = motion_of(straight(12.0 * TIMES - 2.0 * TIMES**2 / 2), TIMES)
    assert motion.acceleration_m_s2 == pytest.approx(np.full(len(TIMES), -2.0), abs=1e-6)


def test_times_need_not_be_even() -> None:
    times = np.cumsum(0.1 + 0.02 * np.sin(np.arange(40)))
    motion = motion_of(straight(3.0 * times + 2.5 * times**2 / 2), times)
    assert motion.acceleration_m_s2 == pytest.approx(np.full(len(times), 2.5), abs=1e-6)


@pytest.mark.parametrize(("radius_m", "speed_m_s"), [(8.0, 4.0), (25.0, 10.0), (60.0, 15.0)])
def test_circle(radius_m: float, speed_m_s: float) -> None:
    motion = motion_of(circle(radius_m, speed_m_s), TIMES)
    assert motion.speed_m_s == pytest.approx(np.full(len(TIMES), speed_m_s), rel=0.01)
    assert motion.curvature_1_m == pytest.approx(np.full(len(TIMES), 1 / radius_m), rel=0.03)
    assert motion.lateral_m_s2 == pytest.approx(np.full(len(TIMES), speed_m_s**2 / radius_m), rel=0.03)
    assert np.abs(motion.acceleration_m_s2).max() < 0.15
    mirrored = motion_of(circle(radius_m, speed_m_s) * [1, -1, 1], TIMES)
    assert mirrored.curvature_1_m == pytest.approx(-motion.curvature_1_m)


def test_noise_of_centimetres_is_no_acceleration() -> None:
    noise = 0.02 * np.random.default_rng(1).standard_normal((len(TIMES), 3))
    positions = straight(10.0 * TIMES) + noise
    motion = motion_of(positions, TIMES)
    plain = np.diff(np.linalg.norm(np.diff(positions, axis=0), axis=1)) / 0.1**2
    assert np.abs(plain).max() > 6.0
    assert not any(where.any() for where in exceeded(motion, Limits()).values())


def test_what_stands_has_no_curvature() -> None:
    noise = 0.02 * np.random.default_rng(1).standard_normal((len(TIMES), 3))
    motion = motion_of(straight(0 * TIMES) + noise, TIMES)
    assert np.isnan(motion.curvature_1_m).all() and np.isnan(motion.lateral_m_s2).all()
    assert not any(where.any() for where in exceeded(motion, Limits()).values())


def test_absence_is_not_travelled() -> None:
    there = (TIMES < 1.0) | (TIMES > 2.0)
    along = np.where(TIMES > 1.5, 500.0, 0.0) + 5.0 * TIMES
    motion = motion_of(straight(along), TIMES, there)
    assert np.isnan(motion.speed_m_s[~there]).all()
    assert motion.speed_m_s[there] == pytest.approx(np.full(there.sum(), 5.0), abs=1e-6)


def test_few_samples() -> None:
    two = motion_of(straight(np.array([0.0, 1.0])), np.array([0.0, 0.5]))
    assert two.speed_m_s == pytest.approx([2.0, 2.0]) and np.isnan(two.acceleration_m_s2).all()
    one = motion_of(straight(np.array([0.0])), np.array([0.0]))
    assert np.isnan(one.speed_m_s).all()
    sparse = motion_of(straight(np.arange(0, 4, 0.5) ** 2), np.arange(0, 4, 0.5))
    assert sparse.acceleration_m_s2 == pytest.approx(np.full(8, 2.0), abs=1e-6)


def test_slopes_of_a_parabola_are_exact() -> None:
    values = np.stack([TIMES**2, 3 * TIMES - 1], -1)
    assert slopes(TIMES, values, 2) == pytest.approx(np.stack([2 * TIMES, np.full(len(TIMES), 3.0)], -1), abs=1e-9)


def test_limits_mark_where_they_are_exceeded() -> None:
    braking = motion_of(straight(20.0 * TIMES - 8.0 * np.maximum(TIMES - 2.0, 0) ** 2 / 2), TIMES)
    where = exceeded(braking, Limits())["acceleration_m_s2"]
    assert not where[TIMES < 1.5].any() and where[(TIMES > 2.4)].all()
    assert not exceeded(braking, Limits(acceleration_m_s2=8.5))["acceleration_m_s2"].any()
    tight = motion_of(circle(4.0, 3.0), TIMES)
    found = exceeded(tight, Limits())
    assert found["curvature_1_m"].all() and not found["lateral_m_s2"].any()
    fast = motion_of(circle(20.0, 10.0), TIMES)
    found = exceeded(fast, Limits())
    assert found["lateral_m_s2"].all() and not found["curvature_1_m"].any()


def test_what_was_recorded_is_no_fault_of_the_edit() -> None:
    fast = motion_of(circle(20.0, 10.0), TIMES)
    assert not exceeded(fast, Limits(), fast)["lateral_m_s2"].any()
    assert exceeded(motion_of(circle(20.0, 10.5), TIMES), Limits(), fast)["lateral_m_s2"].all()


def test_words() -> None:
    assert describe("acceleration_m_s2", -7.2) == "brakes at 7.2 m/s²"
    assert describe("acceleration_m_s2", 7.2) == "accelerates at 7.2 m/s²"
    assert describe("curvature_1_m", -0.25) == "turns at a radius of 4.0 m (0.25 1/m)"
    assert is_limited("Pickup Truck") and not is_limited("Pedestrian")
    assert runs(np.array([True, False, True, True])) == [(0, 1), (2, 4)]
