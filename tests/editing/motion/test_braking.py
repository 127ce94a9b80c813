"""Braking: at the end of a line, and for a stop on a trajectory."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray, quaternion_from_yaw
from unisim_blender.editing.motion.braking import HABITS, Approach, StopInMotion, braked, habits_of, stopped_keys
from unisim_blender.editing.motion.keys import TrajectoryKeys, extended
from unisim_blender.editing.motion.kinematics import Limits, MotionProfile, motion_of
from unisim_blender.editing.sampled.clock import Clock

CLOCK = Clock(np.arange(121.0), np.arange(121.0) / 10)


def straight(speed_m_s: float, wander_m: float = 0.0) -> TrajectoryKeys:
    """Keys at the first 81 frames, straight ahead, with labels that wander."""
    frames: FloatArray = np.arange(81.0)
    x: FloatArray = speed_m_s * frames / 10 + np.random.default_rng(1).normal(0, wander_m, 81)
    return TrajectoryKeys(frames, np.stack([x, 0 * x, 0 * x], -1), quaternion_from_yaw(np.zeros(81)))


def with_stop(keys: TrajectoryKeys, hard: float) -> tuple[StopInMotion, TrajectoryKeys, MotionProfile, FloatArray]:
    """A stop of a second from 1 s on, its keys, its motion and its places along the way."""
    stop = braked(keys, 1.0, 1.0, hard, 2.0, CLOCK)
    now = stopped_keys(keys, stop, CLOCK)
    places = extended(CLOCK.times_s, CLOCK.time_s(now.frames), now.positions)
    return stop, now, motion_of(places, CLOCK.times_s), places[:, 0]


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


@pytest.mark.parametrize("hard", [2.0, 5.5])
def test_it_brakes_stands_and_goes_on(hard: float) -> None:
    keys = straight(10.0)
    stop, now, motion, x = with_stop(keys, hard)
    begins = 1.0 + 10.0 / hard
    assert stop.stands_s == pytest.approx((begins, begins + 1.0), abs=0.02)
    assert x[:11] == pytest.approx(keys.positions[:11, 0]), "what is before stays"
    at = extended(np.array(stop.stands_s), CLOCK.time_s(now.frames), now.positions)[:, 0]
    assert at == pytest.approx(np.full(2, 10 + 100 / (2 * hard)), abs=0.1)
    assert motion.acceleration_m_s2.min() == pytest.approx(-hard, rel=0.03)
    assert motion.acceleration_m_s2.max() == pytest.approx(2.0, rel=0.03)
    after = stop.stands_s[1] + 5.0 + 0.5
    assert motion.speed_m_s[CLOCK.times_s > after] == pytest.approx(10.0, abs=0.01), "as fast as before"


def test_labels_that_wander_do_not_make_it_brake_harder() -> None:
    before = motion_of(extended(CLOCK.times_s, CLOCK.times_s[:81], straight(10.0, 0.01).positions), CLOCK.times_s)
    _, _, motion, _ = with_stop(straight(10.0, 0.01), 5.5)
    noise = np.abs(before.acceleration_m_s2[3:70]).max()
    assert motion.acceleration_m_s2[3:70].min() > -5.5 - noise


def test_what_stands_keeps_standing() -> None:
    stop, now, _, x = with_stop(straight(0.0), 2.0)
    assert stop.stands_s == pytest.approx((1.0, 2.0)) and not x.any() and len(now.frames) > 81


def test_times_there_and_back() -> None:
    stop, *_ = with_stop(straight(10.0), 2.0)
    old = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 7.0])
    assert stop.earlier(stop.later(old)) == pytest.approx(old, abs=1e-6)
    assert stop.later(np.array(0.5)) == 0.5
