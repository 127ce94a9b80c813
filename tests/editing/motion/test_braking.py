"""Braking at the end of a line; other speeds on a trajectory, from a time on and at a time."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray, quaternion_from_yaw
from unisim_blender.editing.motion.braking import (
    HABITS,
    Approach,
    TimeChange,
    changed_keys,
    habits_of,
    other_speed,
    speed_at,
)
from unisim_blender.editing.motion.keys import TrajectoryKeys, extended
from unisim_blender.editing.motion.kinematics import Limits, MotionProfile, motion_of
from unisim_blender.editing.sampled.clock import Clock

CLOCK = Clock(np.arange(121.0), np.arange(121.0) / 10)


def straight(speed_m_s: float, wander_m: float = 0.0) -> TrajectoryKeys:
    """Keys at the first 81 frames, straight ahead, with labels that wander."""
    frames: FloatArray = np.arange(81.0)
    x: FloatArray = speed_m_s * frames / 10 + np.random.default_rng(1).normal(0, wander_m, 81)
    return TrajectoryKeys(frames, np.stack([x, 0 * x, 0 * x], -1), quaternion_from_yaw(np.zeros(81)))


def test_classes_have_their_own_habits() -> None:
    for label, group in (("Car", "CAR"), ("Bus", "TRUCK"), ("Pedestrian", "PERSON"), ("TYPE_CYCLIST", "CYCLE")):
        assert habits_of(label) == HABITS[group]
    for habits in HABITS.values():
        assert habits.comfortable_m_s2 < habits.emergency_m_s2 < Limits().acceleration_m_s2


def test_the_way_to_a_stop() -> None:
    way = Approach(40.0, 8.0, 2.0)
    assert way.duration_s == pytest.approx(3.0 + 4.0)
    assert way.lengths(np.array([0.0, 3.0, 5.0, 7.0, 9.0])) == pytest.approx([0.0, 24.0, 36.0, 40.0, 40.0])
    short = Approach(9.0, 8.0, 2.0)
    assert (short.top_m_s, short.duration_s) == pytest.approx((6.0, 3.0))
    assert short.lengths(np.array([0.0, 3.0])) == pytest.approx([0.0, 9.0])


def motion_with(keys: TrajectoryKeys, change: TimeChange) -> tuple[FloatArray, MotionProfile]:
    """Places (N,) along the way and the motion of what is there at other times."""
    now = changed_keys(keys, change, CLOCK)
    places = extended(CLOCK.times_s, CLOCK.time_s(now.frames), now.positions)
    return places[:, 0], motion_of(places, CLOCK.times_s)


@pytest.mark.parametrize("factor", [0.5, 0.9, 1.0, 1.3, 2.0])
def test_another_speed_is_reached_at_the_given_acceleration(factor: float) -> None:
    x, motion = motion_with(straight(10.0), other_speed(straight(10.0), 1.0, None, factor, 3.0, 2.0, CLOCK))
    by = -3.0 if factor < 1 else 2.0
    takes_s = 10.0 * (factor - 1) / by
    since = np.maximum(CLOCK.times_s - 1.0, 0.0)
    plain = 10 * CLOCK.times_s + by / 2 * np.minimum(since, takes_s) ** 2
    plain += 10 * (factor - 1) * np.maximum(since - takes_s, 0.0)
    assert x == pytest.approx(plain, abs=0.02)
    strongest = np.abs(motion.acceleration_m_s2).max()
    assert strongest <= abs(by) * 1.02 and (factor in (0.9, 1.0) or strongest > abs(by) * 0.95)


@pytest.mark.parametrize(("factor", "last_s"), [(0.5, 3.0), (0.5, 6.0), (0.8, 5.0), (1.3, 6.0), (1.5, 7.0)])
def test_a_stretch_ends_at_its_time(factor: float, last_s: float) -> None:
    keys = straight(10.0)
    change = other_speed(keys, 1.0, last_s, factor, 2.0, 2.0, CLOCK)
    ends_s = 1.0 + (last_s - 1.0) / factor
    assert change.later(np.array([0.5, 1.0, last_s, 7.5])) == pytest.approx(
        [0.5, 1.0, ends_s, 7.5 + ends_s - last_s], abs=1e-9
    )
    x, motion = motion_with(keys, change)
    assert np.interp(ends_s, CLOCK.times_s, x) == pytest.approx(10 * last_s, abs=0.02)
    assert np.abs(motion.acceleration_m_s2).max() == pytest.approx(change.hardest_m_s2, rel=0.08)
    assert change.hardest_m_s2 >= 2.0 and np.diff(motion.speed_m_s).max() < 0.1 * change.hardest_m_s2 * 1.05
    rest = CLOCK.times_s > ends_s + 0.3
    assert motion.speed_m_s[rest] == pytest.approx(10.0, abs=0.05), "then as fast as before"


@pytest.mark.parametrize(("speed_m_s", "reach_s"), [(4.0, 2.0), (0.0, 1.0), (16.0, 2.0), (-3.0, 2.0)])
def test_a_speed_at_a_time_is_what_its_integral_says(speed_m_s: float, reach_s: float) -> None:
    change = speed_at(straight(10.0), 4.0, speed_m_s, reach_s, CLOCK)
    x, motion = motion_with(straight(10.0), change)
    fine = np.linspace(0.0, 12.0, 120_001)
    plain = np.full(len(fine), 10.0)
    for i, time_s in enumerate(fine):
        if abs(time_s - 4.0) < reach_s:
            plain[i] += (speed_m_s - 10.0) * 0.5 * (1 + np.cos(np.pi * (time_s - 4.0) / reach_s))
    plain = np.maximum(plain, 0.0)
    gone = np.append(0.0, np.cumsum((plain[1:] + plain[:-1]) / 2 * np.diff(fine)))
    assert x == pytest.approx(np.interp(CLOCK.times_s, fine, gone), abs=0.01)
    assert motion.speed_m_s[[10, 75]] == pytest.approx([10.0, 10.0], abs=1e-6), "as before beyond its reach"
    assert change.later(np.array([0.0, 1.9])) == pytest.approx([0.0, 1.9], abs=1e-5)


def test_a_changed_speed_never_leaves_the_path() -> None:
    turn: FloatArray = np.linspace(0, np.pi / 2, 81)
    arc = np.stack([20 * np.sin(turn), 20 - 20 * np.cos(turn), 0 * turn], -1)
    keys = TrajectoryKeys(np.arange(81.0), arc, quaternion_from_yaw(turn))
    for change in (speed_at(keys, 3.0, 0.0, 2.0, CLOCK), other_speed(keys, 1.0, None, 0.5, 2.0, 2.0, CLOCK)):
        now = changed_keys(keys, change, CLOCK)
        inside = now.positions[CLOCK.time_s(now.frames) <= 8.0]
        assert np.linalg.norm(inside - [0, 20, 0], axis=1) == pytest.approx(np.full(len(inside), 20.0), abs=0.002)


def test_times_there_and_back() -> None:
    change = other_speed(straight(10.0), 1.0, 5.0, 0.5, 2.0, 2.0, CLOCK)
    old = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 7.0])
    assert change.earlier(change.later(old)) == pytest.approx(old, abs=1e-6)
    assert change.later(np.array(0.5)) == 0.5
