"""Plans as paths, the regulator's gains against a direct solution, and what is refused."""

from __future__ import annotations

import math
from decimal import Decimal
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import torch

from unisim_blender.core.errors import SimulationError
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Control, Plan
from unisim_blender.core.simulation.vehicle.lqr import RegulatorStage, feedbacks, reference_of, track
from unisim_blender.core.simulation.vehicle.parameters import Vehicle

START = EgoState(0.0, 0.0, 0.0, 8.0)


def test_feedback_is_the_least_squares_solution() -> None:
    """Inputs of all stages at once, as one linear problem: the first is the feedback's, and the others along its states."""
    rng = np.random.default_rng(2)
    n, count = 3, 8
    stages = [
        RegulatorStage(
            rng.normal(size=(n, n)), rng.normal(size=n), rng.normal(size=n), rng.uniform(0, 2, n), rng.normal(size=n),
            float(rng.uniform(0.1, 2)), float(rng.normal()),
        )
        for _ in range(count)
    ]  # fmt: skip
    x0 = rng.normal(size=n)
    free, by_input, rows, wanted = x0, np.zeros((n, count)), [], []
    for k, stage in enumerate(stages):
        free, by_input = stage.a @ free + stage.g, stage.a @ by_input
        by_input[:, k] += stage.b
        rows += [np.sqrt(stage.q)[:, None] * by_input, math.sqrt(stage.cost) * np.eye(count)[k : k + 1]]
        wanted += [np.sqrt(stage.q) * (stage.r - free), np.array([math.sqrt(stage.cost) * stage.w])]
    best = np.linalg.lstsq(np.concatenate(rows), np.concatenate(wanted), rcond=None)[0]
    x = x0
    for stage, feedback, expected in zip(stages, feedbacks(stages), best, strict=True):
        found = feedback.input(x)
        assert found == pytest.approx(expected, abs=1e-9)
        x = stage.a @ x + stage.b * found + stage.g


def test_a_path_through_poses_of_a_circle() -> None:
    """A quarter turn of radius 30 m in three poses: within 5 mm of the circle, and as long as it to a thousandth."""
    angle = np.array([0.0, math.pi / 4, math.pi / 2])
    plan = Plan(np.array([0, 3, 6]) * 1_000_000, 30 * np.sin(angle), 30 * (1 - np.cos(angle)), angle)
    reference = reference_of(plan, START, 0, 1.0)
    assert float(reference.distance_at(np.array([6.0]))[0]) == pytest.approx(15 * math.pi, rel=1e-3)
    for at in np.linspace(0, math.pi / 2, 20):
        along, left = reference.path.project(30 * math.sin(at), 30 * (1 - math.cos(at)), 30 * at)
        assert along == pytest.approx(30 * at, abs=0.05) and abs(left) < 0.08
        assert float(reference.path.heading_at(np.array([30 * at]))[0]) == pytest.approx(at, abs=2e-3)
    # two metres inside the circle, and past its end, where it goes on
    assert reference.path.project(28 * math.sin(1), 30 - 28 * math.cos(1), 30.0)[1] == pytest.approx(2, abs=0.05)
    assert reference.path.project(30 * math.sin(1.7), 30 - 30 * math.cos(1.7), 51.0)[1] == pytest.approx(0, abs=0.05)
    assert reference.path.project(-50.0, 3.0, 0.0) == pytest.approx((-50.0, 3.0))


def test_distances_and_speeds_follow_from_poses() -> None:
    """Under a constant acceleration they are exact, and carried on beyond the plan."""
    times = np.arange(0, 5, 0.5)
    plan = Plan(np.round(times * 1e6).astype(np.int64), 2 * times + times**2, 0 * times, 0 * times)
    reference = reference_of(plan, START, 0, 1.0)
    t = np.linspace(0, 4.5, 50)
    np.testing.assert_allclose(reference.speed_at(t), 2 + 2 * t, atol=1e-9)
    np.testing.assert_allclose(reference.distance_at(t), 2 * t + t * t, atol=1e-9)
    np.testing.assert_allclose(reference.distance_at(np.array([-1.0, 5.5])), [-2.0, 9 + 4.5**2 + 11], atol=1e-9)
    given = Plan(plan.times_us, plan.x_m, plan.y_m, plan.heading_rad, 2 + 2 * times)
    np.testing.assert_allclose(reference_of(given, START, 0, 1.0).distance_at(t), 2 * t + t * t, atol=1e-9)


PLAN = {"times_us": [0, 100], "x_m": [0.0, 1.0], "y_m": [0.0, 0.0], "heading_rad": [0.0, 0.0]}


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"x_m": [0.0, math.nan]}, "plan: x_m of pose 1 must be a finite number, not nan"),
        ({"heading_rad": [math.inf, 0.0]}, "plan: heading_rad of pose 0 must be a finite number, not inf"),
        ({"times_us": [100, 100]}, "plan: pose 1 at 100 us is not later than the one before, at 100 us"),
        ({"times_us": [0.0, 1.0]}, "plan: times_us must be a list of whole microseconds, one at least, not [0.0, 1.0]"),
        ({"times_us": []}, "plan: times_us must be a list of whole microseconds, one at least, not []"),
        ({"y_m": [0.0]}, "plan: y_m must be 2 numbers, as many as times_us, not of shape (1,)"),
        ({"y_m": "ab"}, "plan: y_m must be 2 numbers, not 'ab'"),
        ({"speed_m_s": [1.0, -1.0]}, "plan: speed_m_s of pose 1 must not be negative, not -1"),
        ({"speed_m_s": [1.0, math.nan]}, "plan: speed_m_s of pose 1 must be a finite number, not nan"),
    ],
)
def test_plans_that_are_none(changed: dict[str, Any], message: str) -> None:
    Plan(**PLAN)  # type: ignore[arg-type]
    with pytest.raises(SimulationError) as caught:
        Plan(**{**PLAN, **changed})
    assert str(caught.value) == message


def test_controls_states_and_times_that_are_none() -> None:
    plan = Plan(**PLAN)  # type: ignore[arg-type]
    with pytest.raises(SimulationError, match=r"^control: acceleration_m_s2 must be a finite number, not nan$"):
        Control(math.nan, 0.0)
    with pytest.raises(SimulationError, match=r"^control: steering_rad must be a finite number, not 'left'$"):
        Control(0.0, "left")  # type: ignore[arg-type]
    with pytest.raises(SimulationError, match=r"^ego state: heading_rad must be a finite number, not nan$"):
        track(plan, EgoState(0.0, 0.0, math.nan, 0.0), Vehicle(), 0)
    with pytest.raises(SimulationError, match=r"^time_us must be whole microseconds, .* not 0\.5$"):
        track(plan, START, Vehicle(), 0.5)  # type: ignore[arg-type]
    with pytest.raises(SimulationError, match=r"^step_us must be whole microseconds, at least 1, not 0$"):
        track(plan, START, Vehicle(), 0, 0)


@pytest.mark.parametrize(
    "value",
    [
        0.5, np.float32(0.5), np.float16(0.5), np.array(0.5), np.array([0.5]), Fraction(1, 2), Decimal("0.5"),
        torch.tensor(0.5), torch.tensor([0.5], requires_grad=True), torch.tensor(0.5, dtype=torch.bfloat16),
    ],
    ids=repr,
)  # fmt: skip
def test_numbers_of_other_libraries(value: Any) -> None:
    control = Control(value, value)
    assert control == Control(0.5, 0.5) and type(control.acceleration_m_s2) is float
    assert Vehicle(steering_lag_s=value).steering_lag_s == 0.5
    one = value if np.ndim(value) else [value]
    plan = Plan([7], one, one, one, one)  # type: ignore[arg-type]
    assert [one.tolist() for one in (plan.x_m, plan.y_m, plan.heading_rad, plan.speed_m_s)] == [[0.5]] * 4  # type: ignore[union-attr]


def test_whole_numbers_of_other_libraries() -> None:
    for number in (3, np.int64(3), np.uint8(3), np.array(3), torch.tensor(3), torch.tensor(3, dtype=torch.int16)):
        assert Control(number, 0.0).acceleration_m_s2 == 3.0  # type: ignore[arg-type]
        plan = Plan([number, 4], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0])  # type: ignore[arg-type]
        assert plan.times_us.tolist() == [3, 4] and plan.times_us.dtype == np.int64
        assert track(plan, START, Vehicle(), number, number) == track(plan, START, Vehicle(), 3, 3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "value",
    [
        math.inf, np.float32("nan"), torch.tensor(math.nan), True, np.True_, torch.tensor(True), "0.5", b"1", np.array("1"),
        None, 1j, np.complex64(1), [], [0.5, 0.5], [[0.5]], np.zeros(2), torch.zeros(1, 2), np.ma.masked, np.timedelta64(5, "ns"),
        10**400, np.array([None]), (one for one in (0.5,)),
    ],
    ids=lambda value: f"{type(value).__name__} {value!r}"[:24],
)  # fmt: skip
def test_what_is_no_number(value: Any) -> None:
    with pytest.raises(SimulationError, match=r"^control: steering_rad must be a finite number, not "):
        Control(0.0, value)
    with pytest.raises(SimulationError, match=r"^plan: y_m (must be 1 numbers|of pose 0 must be a finite number)"):
        Plan(np.array([7]), np.zeros(1), np.array([value]) if isinstance(value, bool) else value, np.zeros(1))


def test_a_plan_is_a_copy() -> None:
    """A driver may use its arrays and tensors again for the next plan."""
    times, x, y = np.array([1, 2]), np.zeros(2), torch.zeros(2, dtype=torch.float64)
    plan = Plan(times, x, y, [0.0, 0.0])  # type: ignore[arg-type]
    times[:], x[:], y[:] = 9, 9, 9
    assert plan.times_us.tolist() == [1, 2] and not plan.x_m.any() and not plan.y_m.any()


@pytest.mark.parametrize(
    "times",
    [np.array([10**14]), np.array([2**64 - 1], np.uint64), [True], [1.0], [np.ma.masked]],
    ids=repr,
)
def test_times_that_are_none(times: Any) -> None:
    with pytest.raises(
        SimulationError, match=r"^plan: times_us must be a list of whole microseconds, one at least, not"
    ):
        Plan(times, np.zeros(1), np.zeros(1), np.zeros(1))


def test_vehicles_go_to_json_and_back() -> None:
    for vehicle in (
        Vehicle(),
        Vehicle(wheelbase_m=3.1, length_m=5.2, rear_axle_m=(-1.4, 0.0, -0.3), steering_lag_s=0.0),
    ):
        assert Vehicle.from_dict(vehicle.to_dict()) == vehicle
    assert Vehicle.from_dict({}) == Vehicle() and Vehicle.from_dict({"rear_axle_m": [1, 2, 3]}).rear_axle_m == (1, 2, 3)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"wheelbase_m": 0}, "s.json: vehicle: wheelbase_m must be a finite number from 0.5 to 20, not 0"),
        ({"steering_lag_s": math.nan}, "s.json: vehicle: steering_lag_s must be a finite number from 0 to 10, not nan"),
        ({"width_m": True}, "s.json: vehicle: width_m must be a finite number from 0.2 to 5, not True"),
        ({"rear_axle_m": [1, 2]}, "s.json: vehicle: rear_axle_m must be three numbers, not [1, 2]"),
        ({"rear_axle_m": [1, 2, 30]}, "s.json: vehicle: rear_axle_m must be a finite number from -20 to 20, not 30"),
        (
            {"length_m": 3},
            "s.json: vehicle: length_m must be at least wheelbase_m and rear_overhang_m together, 3.85, not 3",
        ),
        ({"width_m": 1.5}, "s.json: vehicle: width_m must be at least track_m, 1.6, not 1.5"),
        ([], "s.json: vehicle: must be an object, not []"),
    ],
)
def test_vehicles_that_are_none(values: Any, message: str) -> None:
    with pytest.raises(SimulationError) as caught:
        Vehicle.from_dict(values, "s.json: vehicle")
    assert str(caught.value) == message
    with pytest.raises(SimulationError, match=r"^vehicle: has no parameter 'mass', only wheelbase_m, track_m"):
        Vehicle.from_dict({"mass": 1})
