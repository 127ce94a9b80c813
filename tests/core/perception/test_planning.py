"""The example stack's lattice planner: its polynomials, its candidates, and the vehicle driven by its plans."""

from __future__ import annotations

import math
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[3]))

from examples.perception.candidates import HARDEST_M_S2, OFFSETS_M, TIMES_S, Start, candidates
from examples.perception.forecast import forecast
from examples.perception.lattice import GAP_M, LatticePlanner, keeps_limits
from examples.perception.objects import Detection, Mode
from examples.perception.polynomials import quartic, quintic, values
from examples.perception.route import Route
from examples.perception.tracker import Tracker
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.bicycle import substates
from unisim_blender.core.simulation.vehicle.lqr import track
from unisim_blender.core.simulation.vehicle.parameters import Vehicle

VEHICLE = Vehicle()
FRONT_M = VEHICLE.length_m - VEHICLE.rear_overhang_m
ALONG_X = Route.through(np.stack([np.arange(0.0, 150.0), np.zeros(150)], -1))
CAR = np.array([40.0, 0.0, 4.5, 1.9, 0.0])


def standing(box: np.ndarray = CAR) -> tuple[Mode, ...]:  # type: ignore[type-arg]
    return (Mode(np.tile(box, (len(TIMES_S), 1)), 1.0, len(TIMES_S)),)


def test_quintics_meet_both_states_and_quartics_the_rate() -> None:
    start = (1.0, -2.0, 0.5)
    end, length = np.array([[7.0, 1.0, -0.3], [0.0, 0.0, 0.0]]), np.array([3.0, 5.0])
    found = quintic(start, end, length)
    for order in range(3):
        assert values(found, np.zeros((2, 1)), order)[:, 0] == pytest.approx(start[order])
        assert values(found, length[:, None], order)[:, 0] == pytest.approx(end[:, order])
    found = quartic(start, np.array([4.0, 0.0]), length)
    assert values(found, length[:, None], 1)[:, 0] == pytest.approx([4.0, 0.0])
    assert values(found, length[:, None], 2)[:, 0] == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_quintic_has_the_least_jerk() -> None:
    """Anything that is added and changes neither end costs more."""
    t = np.linspace(0, 4, 4001)
    best = quintic((0.0, 3.0, 0.0), np.array([[10.0, 0.0, 0.0]]), np.array([4.0]))
    jerk = values(best, t[None], 3)[0]
    bump = np.polyder(np.poly1d([1, 0]) ** 3 * np.poly1d([-1, 4]) ** 3, 3)(t)
    cost = [float(((jerk + share * bump) ** 2).mean()) for share in (-0.01, 0.0, 0.01)]
    assert cost[1] < min(cost[0], cost[2])


def test_candidates_begin_as_the_vehicle_moves_and_follow_their_headings() -> None:
    angle = np.linspace(0, 1.5, 100)
    bend = Route.through(60 * np.stack([np.sin(angle), 1 - np.cos(angle)], -1))
    x, y = bend.place(np.array(10.0), np.array(0.5))
    ego = EgoState(float(x), float(y), 10 / 60 + 0.05, 8.0, -0.5)
    made = candidates(Start.of(ego, VEHICLE, bend), bend, 8.0, (50.0,))
    assert np.ptp(made.x_m[:, 0]) < 1e-9 and made.x_m[0, 0] == pytest.approx(ego.x_m, abs=1e-3)
    assert made.heading_rad[:, 0] == pytest.approx(ego.heading_rad, abs=5e-3)
    assert made.speed_m_s[:, 0] == pytest.approx(8.0, rel=1e-3)
    moved = np.hypot(np.diff(made.x_m), np.diff(made.y_m))
    straight = moved > 0.5
    course = np.arctan2(np.diff(made.y_m), np.diff(made.x_m))
    middle = (made.heading_rad[:, 1:] + made.heading_rad[:, :-1]) / 2
    off = np.abs(np.angle(np.exp(1j * (course - middle))))[straight & keeps_limits(made)[:, None]]
    assert off.max() < 0.02
    assert moved == pytest.approx((made.speed_m_s[:, 1:] + made.speed_m_s[:, :-1]) / 2 * 0.25, abs=0.06)


def test_candidates_stop_at_a_place() -> None:
    made = candidates(Start((0.0, 8.0, 0.0), (0.0, 0.0, 0.0)), ALONG_X, 8.0, (20.0,))
    stops = (np.abs(made.s_m[:, -1] - 20) < 1e-6) & (made.rate[:, -1] < 1e-6)
    assert stops.sum() >= 2 * len(OFFSETS_M)


def test_a_free_route_is_driven_at_the_speed_that_is_wanted() -> None:
    planned = LatticePlanner(VEHICLE, ALONG_X, 8.0).plan(0, EgoState(0, 0, 0, 8.0), [])
    assert planned.is_free and planned.plan.speed_m_s == pytest.approx(8.0)
    assert np.abs(planned.plan.y_m).max() < 1e-9 and planned.plan.times_us[-1] == 6_000_000


def test_it_stops_behind_a_box_and_not_beside_one() -> None:
    planner = LatticePlanner(VEHICLE, ALONG_X, 8.0)
    planned = planner.plan(0, EgoState(0, 0, 0, 8.0), [standing()])
    assert planned.is_free and planned.plan.x_m[-1] + FRONT_M < CAR[0] - CAR[2] / 2
    beside = CAR + np.array([0, 2.6, 0, 0, 0])
    planned = planner.plan(0, EgoState(0, 0, 0, 8.0), [standing(beside)])
    assert planned.is_free and planned.plan.x_m[-1] > 45
    behind = CAR - np.array([50, 0, 0, 0, 0])
    assert planner.plan(0, EgoState(0, 0, 0, 8.0), [standing(behind)]).plan.speed_m_s == pytest.approx(8.0)


def test_it_brakes_as_hard_as_it_can_where_nothing_is_free() -> None:
    planned = LatticePlanner(VEHICLE, ALONG_X, 8.0).plan(0, EgoState(0, 0, 0, 8.0), [standing(CAR - [31, 0, 0, 0, 0])])
    speeds = planned.plan.speed_m_s
    assert not planned.is_free and speeds is not None
    assert np.diff(speeds[:4]) / 0.25 == pytest.approx(-HARDEST_M_S2)


@pytest.mark.parametrize("deviation_m", [0.2, 1.0])
def test_the_vehicle_stops_behind_what_is_tracked(deviation_m: float) -> None:
    """Tracker, forecasts, planner and vehicle together; without the detections it drives through."""
    for sees in (True, False):
        rng = np.random.default_rng(3)
        ego, tracker = EgoState(0, 0.2, 0.02, 8.0), Tracker()
        planner = LatticePlanner(VEHICLE, ALONG_X, 8.0)
        for number in range(90):
            box = CAR + np.append(rng.normal(0, deviation_m, 2), np.zeros(3))
            tracker.update(0.1 * number, [Detection(box, np.eye(2) * deviation_m**2, 0.9)] if sees else [])
            forecasts = [forecast(one, ALONG_X, TIMES_S) for one in tracker.confirmed]
            planned = planner.plan(100_000 * number, ego, forecasts)
            control = track(planned.plan, ego, VEHICLE, 100_000 * number)
            ego = [state for _, state in substates(ego, control, VEHICLE, 100_000)][-1]
        gap = CAR[0] - CAR[2] / 2 - ego.x_m - FRONT_M
        if sees:
            assert ego.speed_m_s < 0.8 and 1.0 < gap < GAP_M + 2 and abs(ego.y_m) < 0.7
        else:
            assert gap < -10 and ego.speed_m_s == pytest.approx(8.0, abs=0.1)


def test_a_vehicle_that_is_beside_the_route_returns_to_it() -> None:
    ego, planner = EgoState(0, 1.5, 0.0, 8.0), LatticePlanner(VEHICLE, ALONG_X, 8.0)
    for number in range(120):
        planned = planner.plan(100_000 * number, ego, [])
        control = track(planned.plan, ego, VEHICLE, 100_000 * number)
        ego = [state for _, state in substates(ego, control, VEHICLE, 100_000)][-1]
    assert abs(ego.y_m) < 0.1 and abs(math.remainder(ego.heading_rad, math.tau)) < 0.02
    assert Start.of(replace(ego, heading_rad=0.0, y_m=0.0), VEHICLE, ALONG_X).across == pytest.approx(
        (0, 0, 0), abs=0.02
    )
