"""The tracker in a loop with the bicycle: how near to its plan the vehicle stays, and that it stops."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Plan
from unisim_blender.core.simulation.vehicle.bicycle import advance
from unisim_blender.core.simulation.vehicle.lqr import track
from unisim_blender.core.simulation.vehicle.parameters import Vehicle

VEHICLE = Vehicle()
START_US = 7_000_000


def along(
    distance: Callable[[FloatArray], FloatArray], seconds: float, every_s: float = 0.1, radius_m: float = math.inf
) -> Plan:
    """A plan from the origin along x, or along a circle to the left."""
    times = np.arange(0.0, seconds + every_s / 2, every_s)
    s = np.asarray(distance(times), float)
    times_us = START_US + np.round(times * 1e6).astype(np.int64)
    if math.isinf(radius_m):
        return Plan(times_us, s, np.zeros(len(s)), np.zeros(len(s)))
    heading = s / radius_m
    return Plan(times_us, radius_m * np.sin(heading), np.asarray(radius_m * (1 - np.cos(heading))), heading)


def driven(plan: Plan, state: EgoState, seconds: float, step_us: int = 100_000) -> list[EgoState]:
    """The states at the start and after each step."""
    states = [state]
    for time_us in range(START_US, START_US + round(seconds * 1e6), step_us):
        control = track(plan, states[-1], VEHICLE, time_us, step_us)
        states.append(advance(states[-1], control, VEHICLE, step_us))
    return states


def lateral_m_s2(states: list[EgoState]) -> float:
    return max(one.speed_m_s**2 * abs(math.tan(one.steering_rad)) / VEHICLE.wheelbase_m for one in states)


def test_a_straight_is_followed() -> None:
    for state in driven(along(lambda t: 8 * t, 4.0), EgoState(0.0, 0.0, 0.0, 8.0), 4.0):
        assert abs(state.y_m) < 1e-9 and abs(state.heading_rad) < 1e-9 and abs(state.speed_m_s - 8) < 1e-6


@pytest.mark.parametrize(
    ("radius_m", "length_m", "every_s"),
    [(150.0, 150.0, 0.1), (150.0, 80.0, 0.5), (-150.0, 80.0, 1.0), (20.0, 40.0, 0.5)],
)
def test_an_arc_at_8_m_s(radius_m: float, length_m: float, every_s: float) -> None:
    """From a straight steering: with radius 150 m within 5 cm always, at the end within 5 mm."""
    plan = along(lambda t: 8 * t, length_m / 8, every_s, radius_m)
    states = driven(plan, EgoState(0.0, 0.0, 0.0, 8.0), math.floor(length_m / 8 * 10 - 1) / 10)
    off = [math.hypot(one.x_m, one.y_m - radius_m) - abs(radius_m) for one in states]
    assert max(map(abs, off)) < (0.05 if abs(radius_m) > 100 else 0.1)
    assert abs(off[-1]) < 5e-3
    expected = 8 * (len(states) - 1) / 10 / radius_m
    assert abs(states[-1].heading_rad - expected) * abs(radius_m) < 0.1


def test_a_lane_change() -> None:
    """3.5 m to the left in 4 s at 15 m/s: a quintic, whose lateral acceleration is up to 1.26 m/s^2."""
    times = np.arange(0, 6.01, 0.1)
    u = np.clip(times / 4, 0, 1)
    y, rate = 3.5 * (10 * u**3 - 15 * u**4 + 6 * u**5), 3.5 * 30 * (u**2 - 2 * u**3 + u**4) / 4
    plan = Plan(START_US + np.round(times * 1e6).astype(np.int64), 15 * times, y, np.arctan2(rate, 15))
    states = driven(plan, EgoState(0.0, 0.0, 0.0, 15.0), 5.9)
    assert max(abs(one.y_m - np.interp(one.x_m, plan.x_m, plan.y_m)) for one in states) < 0.05
    assert abs(states[-1].y_m - 3.5) < 0.01 and abs(states[-1].heading_rad) < 2e-3
    assert lateral_m_s2(states) < 1.5


def test_from_a_standstill() -> None:
    states = driven(along(lambda t: 0.75 * t**2, 4.0), EgoState(0.0, 0.0, 0.0, 0.0), 3.9)
    assert abs(states[-1].x_m - 0.75 * 3.9**2) < 0.2 and abs(states[-1].speed_m_s - 1.5 * 3.9) < 0.2
    assert max(one.acceleration_m_s2 for one in states) < 2.2


def test_a_stop_is_exact_and_lasts() -> None:
    """From 8 m/s at -2 m/s^2: 16 m in 4 s, and then standing, among poses that jitter by a centimetre."""
    plan = along(lambda t: 8 * np.minimum(t, 4) - np.minimum(t, 4) ** 2, 9.0)
    jitter = np.random.default_rng(5).normal(0, 0.01, (2, len(plan.times_us)))
    noisy = Plan(plan.times_us, plan.x_m + jitter[0], plan.y_m + jitter[1], plan.heading_rad)
    for one, most in ((plan, 0.15), (noisy, 0.3)):
        states = driven(one, EgoState(0.0, 0.0, 0.0, 8.0, -2.0), 8.9)
        assert abs(states[-1].x_m - 16) < most and states[-1].speed_m_s == 0
        stopped = [state.speed_m_s for state in states].index(0.0)
        assert stopped < 50
        assert {(state.x_m, state.y_m, state.speed_m_s) for state in states[stopped:]} == {
            (states[-1].x_m, states[-1].y_m, 0.0)
        }


def test_a_vehicle_that_stands_stays() -> None:
    """On its place and beside it: the place cannot be reached without driving."""
    for x, y, heading in ((0.0, 0.0, 0.0), (0.2, 2.0, -0.3), (-0.3, -1.0, 3.0)):
        start = EgoState(x, y, heading, 0.0)
        for state in driven(along(lambda t: 0 * t, 2.0), start, 1.0):
            assert (state.x_m, state.y_m, state.heading_rad, state.speed_m_s) == (x, y, heading, 0.0)
            assert math.isfinite(state.steering_rad)


@pytest.mark.parametrize("speed", [2.0, 60.0])
@pytest.mark.parametrize("step_us", [20_000, 100_000, 500_000])
def test_it_returns_from_beside_the_path(speed: float, step_us: int) -> None:
    """From 1 m beside, and 0.01 rad off: it is back after 8 s and overshoots by a tenth."""
    plan = along(lambda t: speed * t, 10.0, 0.5)
    states = driven(plan, EgoState(0.0, 1.0, 0.01, speed), 8.0, step_us)
    assert abs(states[-1].y_m) < 0.02 and min(one.y_m for one in states) > -0.1
    assert lateral_m_s2(states) < 5 and abs(states[-1].speed_m_s - speed) < 0.1


def test_far_beside_the_path_it_returns_at_an_angle() -> None:
    states = driven(along(lambda t: 10 * t, 15.0, 0.5), EgoState(0.0, -20.0, 0.0, 10.0), 14.0)
    assert max(abs(one.heading_rad) for one in states) < 0.6 and abs(states[-1].y_m) < 0.1
    assert lateral_m_s2(states) < 6


def test_a_plan_that_is_behind_is_let_catch_up() -> None:
    """The place of the plan is 3 m behind, its first pose 11 m behind and 1 s old; the vehicle never brakes to less than half
    its speed. A plan that stays behind is waited for."""
    plan = along(lambda t: 8 * t, 8.0)
    older = Plan(plan.times_us - 1_000_000, plan.x_m - 11, plan.y_m, plan.heading_rad)
    states = driven(older, EgoState(0.0, 0.0, 0.0, 8.0), 6.0)
    assert abs(states[-1].x_m - (8 * 7 - 11)) < 0.1 and min(one.speed_m_s for one in states) > 4
    far = Plan(plan.times_us, plan.x_m / 8 - 30, plan.y_m, plan.heading_rad)
    states = driven(far, EgoState(0.0, 0.0, 0.0, 8.0), 6.0)
    assert states[-1].speed_m_s == 0 and states[-1].x_m < 20


def test_a_vehicle_that_is_behind_catches_up() -> None:
    states = driven(along(lambda t: 8 * t, 10.0), EgoState(-8.0, 0.0, 0.0, 8.0), 9.0)
    assert abs(states[-1].x_m - 72) < 0.2 and max(one.speed_m_s for one in states) < 12


def test_after_its_last_pose_the_vehicle_brakes_to_a_stop() -> None:
    """On a straight, and on a circle, on which it stays."""
    for radius in (math.inf, 50.0):
        states = driven(along(lambda t: 8 * t, 1.0, 0.1, radius), EgoState(0.0, 0.0, 0.0, 8.0), 6.0)
        assert states[9].speed_m_s > 7.9  # until its end the plan is followed, and not braked for
        stopped = [state.speed_m_s for state in states].index(0.0)
        assert states[-1].speed_m_s == 0 and states[-1].x_m == states[stopped].x_m
        assert min(one.acceleration_m_s2 for one in states) >= -4.0
        off = states[-1].y_m if math.isinf(radius) else math.hypot(states[-1].x_m, states[-1].y_m - radius) - radius
        assert abs(off) < 0.1


def test_a_plan_of_one_pose() -> None:
    """Due already, it is a place to stop at; still to come, it is one to drive to."""
    due = Plan(np.array([START_US]), np.array([3.0]), np.zeros(1), np.zeros(1))
    states = driven(due, EgoState(0.0, 0.0, 0.0, 5.0), 4.0)
    assert states[-1].speed_m_s == 0 and abs(states[-1].y_m) < 1e-9
    ahead = Plan(np.array([START_US + 4_000_000]), np.array([30.0]), np.array([2.0]), np.zeros(1))
    states = driven(ahead, EgoState(0.0, 0.0, 0.0, 8.0), 8.0)
    assert abs(states[40].x_m - 30) < 1.0 and abs(states[40].y_m - 2) < 0.3
    assert states[-1].speed_m_s == 0


def test_a_plan_that_begins_later_is_approached() -> None:
    """A first pose in half a second, as planners give them, with and without speeds."""
    times = np.arange(0.5, 4.01, 0.5)
    for speed in (None, np.full(8, 8.0)):
        plan = Plan(START_US + np.round(times * 1e6).astype(np.int64), 8 * times, 0 * times, 0 * times, speed)
        states = driven(plan, EgoState(0.0, 0.0, 0.0, 8.0), 3.9)
        assert max(abs(one.speed_m_s - 8) for one in states) < 0.01 and abs(states[-1].x_m - 8 * 3.9) < 0.02


def test_a_plan_that_leads_backwards_is_waited_at() -> None:
    states = driven(along(lambda t: -2 * t, 4.0), EgoState(0.0, 0.0, 0.0, 3.0), 3.0)
    assert states[-1].speed_m_s == 0 and states[-1].x_m < 5


def test_headings_may_wrap() -> None:
    """The same plan turned by half a turn, its headings on both sides of the cut."""
    plan = along(lambda t: 8 * t, 3.0, 0.1, 40.0)
    turned = Plan(plan.times_us, -plan.x_m, -plan.y_m, np.angle(np.exp(1j * (plan.heading_rad + math.pi - 0.2 + 0.2))))
    for time_s in (0.0, 1.0):
        time_us = START_US + round(time_s * 1e6)
        one = track(plan, EgoState(0.0, 0.1, 0.05, 8.0), VEHICLE, time_us)
        other = track(turned, EgoState(0.0, -0.1, 0.05 - math.pi, 8.0), VEHICLE, time_us)
        assert abs(one.acceleration_m_s2 - other.acceleration_m_s2) < 1e-9
        assert abs(one.steering_rad - other.steering_rad) < 1e-9


def test_a_path_that_crosses_itself() -> None:
    """A full circle of 10 m and on: the vehicle at its start does not mistake its end for the way."""
    plan = along(lambda t: 5 * t, 14.0, 0.2, 10.0)
    states = driven(plan, EgoState(0.0, 0.0, 0.0, 5.0), 13.0)
    assert abs(states[-1].heading_rad - 6.5) < 0.05
    assert max(abs(math.hypot(one.x_m, one.y_m - 10) - 10) for one in states) < 0.1


def test_any_plan_gives_a_control_within_limits_and_the_same_twice() -> None:
    rng = np.random.default_rng(11)
    for case in range(60):
        count = int(rng.integers(1, 12))
        gaps_us = rng.integers(1, 10 ** int(rng.integers(1, 8)), count)
        times_us = START_US + np.cumsum(gaps_us) - int(rng.integers(0, 2)) * 10**6
        scale = 10.0 ** rng.integers(-3, 5)
        x, y = rng.normal(0, scale, (2, count))
        speed = None if case % 2 else rng.uniform(0, 90, count)
        plan = Plan(times_us, x, y, rng.uniform(-9, 9, count), speed)
        x0, y0 = rng.normal(0, scale, 2).tolist()
        state = EgoState(x0, y0, *rng.uniform([-9, 0, -9, -1], [9, 60, 5, 1]).tolist())
        step_us = int(rng.integers(1, 10**6))
        control = track(plan, state, VEHICLE, START_US, step_us)
        assert -9 <= control.acceleration_m_s2 <= 5 and abs(control.steering_rad) <= VEHICLE.max_steering_rad
        assert control == track(plan, state, VEHICLE, START_US, step_us)
