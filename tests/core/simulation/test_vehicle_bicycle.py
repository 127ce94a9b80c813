"""The kinematic bicycle against its closed forms.

Height, roll and pitch: on the recorded drive as recorded, beside it by the ground.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from unisim_blender.core.errors import SimulationError
from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.simulation.vehicle.bicycle import advance, substates
from unisim_blender.core.simulation.vehicle.ground import VehicleGround
from unisim_blender.core.simulation.vehicle.parameters import Attitude, Vehicle, footprint_of, pose_of, state_of

VEHICLE = Vehicle()
FREE = Vehicle(max_lateral_acceleration_m_s2=1e4)
"""One whose tyres hold in every turn."""


@pytest.mark.parametrize("steering", [0.001, 0.1, -0.5, math.pi / 3])
@pytest.mark.parametrize("speed", [0.01, 8.0, 60.0])
def test_constant_steering_is_a_circle(steering: float, speed: float) -> None:
    radius = FREE.wheelbase_m / math.tan(steering)
    start = EgoState(100.0, -50.0, 0.7, speed, 0.0, steering)
    centre = (100.0 - radius * math.sin(0.7), -50.0 + radius * math.cos(0.7))
    for time_us, state in substates(start, Control(0.0, steering), FREE, 4_567_891):
        turned = 0.7 + speed * time_us / 1e6 / radius
        assert abs(state.heading_rad - turned) < 1e-9
        assert abs(state.x_m - centre[0] - radius * math.sin(turned)) < 1e-8
        assert abs(state.y_m - centre[1] + radius * math.cos(turned)) < 1e-8
        assert state.speed_m_s == speed


@pytest.mark.parametrize(("speed", "steering"), [(8.0, math.pi / 3), (8.0, -0.9), (30.0, 0.1), (15.0, 0.09)])
def test_a_vehicle_turns_no_tighter_than_its_tyres_hold(speed: float, steering: float) -> None:
    """At a limit a, the circle has the radius v^2 / a, and the yaw rate is a / v; at full lock and 8 m/s no limit is 39 m/s^2."""
    limit = 4.0
    vehicle = Vehicle(max_lateral_acceleration_m_s2=limit, steering_lag_s=0.0)
    asked = speed**2 * math.tan(abs(steering)) / vehicle.wheelbase_m
    assert asked > limit
    start, seconds = EgoState(0.0, 0.0, 0.0, speed, 0.0, steering), 1.5
    state = advance(start, Control(0.0, steering), vehicle, round(seconds * 1e6))
    assert abs(state.heading_rad - math.copysign(limit / speed * seconds, steering)) < 1e-9
    radius = math.copysign(speed**2 / limit, steering)
    assert abs(math.hypot(state.x_m, state.y_m - radius) - abs(radius)) < 1e-8
    assert state.speed_m_s == speed and state.steering_rad == steering
    # below the limit nothing changes, to the bit
    gentle = Control(0.5, math.copysign(0.02, steering))
    slow = EgoState(0.0, 0.0, 0.0, 5.0, 0.0, 0.01)
    assert advance(slow, gentle, vehicle, 1_234_567) == advance(
        slow, gentle, replace(vehicle, max_lateral_acceleration_m_s2=1e4), 1_234_567
    )
    # the wheels stay as they are: it turns as they ask once it is slow enough
    braked = substates(state, Control(-9.0, steering), vehicle, 4_000_000)
    lateral = [
        (b.heading_rad - a.heading_rad) / 0.01 * (a.speed_m_s + b.speed_m_s) / 2
        for (_, a), (_, b) in zip(braked, braked[1:], strict=False)
    ]
    assert max(map(abs, lateral)) < limit * 1.01


def test_constant_acceleration() -> None:
    state = advance(EgoState(1.0, 2.0, math.pi / 2, 3.0, 1.5), Control(1.5, 0.0), VEHICLE, 4_005_000)
    t = 4.005
    assert abs(state.x_m - 1.0) < 1e-12 and abs(state.y_m - (2 + 3 * t + 0.75 * t * t)) < 1e-11
    assert abs(state.speed_m_s - (3 + 1.5 * t)) < 1e-12 and state.acceleration_m_s2 == 1.5


@pytest.mark.parametrize("duration_us", [1, 9_999, 10_000, 123_456, 2_000_000])
def test_lags_are_exponential(duration_us: int) -> None:
    start = EgoState(0.0, 0.0, 0.0, 10.0, -1.0, 0.3)
    state = advance(start, Control(2.0, -0.2), VEHICLE, duration_us)
    t = duration_us / 1e6
    assert abs(state.acceleration_m_s2 - (2 - 3 * math.exp(-t / 0.2))) < 1e-13
    assert abs(state.steering_rad - (-0.2 + 0.5 * math.exp(-t / 0.05))) < 1e-13
    assert abs(state.speed_m_s - (10 + 2 * t - 3 * 0.2 * (1 - math.exp(-t / 0.2)))) < 1e-12


def test_without_lags_a_control_acts_at_once() -> None:
    direct = Vehicle(acceleration_lag_s=0.0, steering_lag_s=0.0)
    state = advance(EgoState(0.0, 0.0, 0.0, 5.0, -3.0, 0.5), Control(1.0, 0.1), direct, 1_000_000)
    assert (state.acceleration_m_s2, state.steering_rad) == (1.0, 0.1) and abs(state.speed_m_s - 6) < 1e-12
    assert abs(state.heading_rad - 5.5 * math.tan(0.1) / 2.85) < 1e-12
    stopped = advance(replace(state, speed_m_s=1.0), Control(-4.0, 0.0), direct, 500_000)
    assert stopped.speed_m_s == 0 and abs(math.hypot(stopped.x_m - state.x_m, stopped.y_m - state.y_m) - 0.125) < 1e-12


def test_a_steering_angle_that_changes_against_a_fine_integration() -> None:
    """Runge-Kutta of fourth order with steps of 0.1 ms, acceleration and steering both lagging."""
    control, start = Control(2.0, 0.3), EgoState(0.0, 0.0, 0.0, 15.0, -2.0, -0.2)
    lags = 1 / np.array([FREE.acceleration_lag_s, FREE.steering_lag_s])

    def slope(x: FloatArray) -> FloatArray:
        _, _, heading, speed, acceleration, steering = x
        turning = speed * math.tan(steering) / FREE.wheelbase_m
        moving = [speed * math.cos(heading), speed * math.sin(heading), turning, acceleration]
        return np.array([*moving, *((np.array([2.0, 0.3]) - [acceleration, steering]) * lags)])

    x, h = np.array([0.0, 0.0, 0.0, 15.0, -2.0, -0.2]), 1e-4
    for _ in range(10_000):
        a = slope(x)
        b = slope(x + h / 2 * a)
        c = slope(x + h / 2 * b)
        x = x + h / 6 * (a + 2 * b + 2 * c + slope(x + h * c))
    state = advance(start, control, FREE, 1_000_000)
    assert math.hypot(state.x_m - x[0], state.y_m - x[1]) < 5e-3 and abs(state.heading_rad - x[2]) < 1e-3
    assert abs(state.speed_m_s - x[3]) < 1e-9


@pytest.mark.parametrize("speed", [0.013, 0.5, 3.0])
@pytest.mark.parametrize("duration_us", [10_000, 1_234_567, 5_000_000])
def test_a_vehicle_that_brakes_stops_exactly_and_stays(speed: float, duration_us: int) -> None:
    """At -4 m/s^2 from the start it stops after v / 4 and v^2 / 8, within a sub-step."""
    start = EgoState(0.0, 0.0, 0.0, speed, -4.0)
    states = [state for _, state in substates(start, Control(-4.0, 0.0), VEHICLE, duration_us)]
    assert min(state.speed_m_s for state in states) >= 0
    if duration_us / 1e6 > speed / 4:
        last = states[-1]
        assert last.speed_m_s == 0.0 and last.acceleration_m_s2 == 0.0
        assert abs(last.x_m - speed**2 / 8) < 1e-12
        later = advance(last, Control(-1.0, 0.4), VEHICLE, 60_000_000)
        assert (later.x_m, later.y_m, later.heading_rad, later.speed_m_s) == (last.x_m, last.y_m, last.heading_rad, 0.0)
        assert abs(later.steering_rad - 0.4) < 1e-12
        still = advance(last, Control(0.0, 0.0), VEHICLE, 60_000_000)
        assert (still.x_m, still.speed_m_s) == (last.x_m, 0.0)


def test_a_lagging_brake_stops_where_the_speed_is_zero() -> None:
    """The speed 1 - 3 t + 0.6 (1 - exp(-t / 0.2)), and its integral, at the root that bisection finds."""
    low, high = 0.0, 1.0
    for _ in range(100):
        t = (low + high) / 2
        low, high = (t, high) if 1 - 3 * t + 0.6 * (1 - math.exp(-t / 0.2)) > 0 else (low, t)
    distance = low - 1.5 * low**2 + 0.6 * (low - 0.2 * (1 - math.exp(-low / 0.2)))
    state = advance(EgoState(0.0, 0.0, 0.0, 1.0), Control(-3.0, 0.0), VEHICLE, 2_000_000)
    assert state.speed_m_s == 0 and abs(state.x_m - distance) < 1e-12


def test_a_brake_that_is_released_while_the_vehicle_stops() -> None:
    """It stops in the middle of a sub-step and starts from there with no acceleration."""
    start = EgoState(0.0, 0.0, 0.0, 0.01, -3.0)
    states = [state for _, state in substates(start, Control(2.0, 0.0), VEHICLE, 1_000_000)]
    assert [state.speed_m_s for state in states] == sorted(state.speed_m_s for state in states)
    stop = 0.01 / 3 + 1e-4
    after = 1 - stop
    expected = 2 * after - 2 * 0.2 * (1 - math.exp(-after / 0.2))
    assert abs(states[-1].speed_m_s - expected) < 1e-3 and states[0].acceleration_m_s2 > 0


def test_from_a_standstill_it_starts_with_the_control() -> None:
    state = advance(EgoState(0.0, 0.0, 0.0, 0.0, -3.0), Control(1.0, 0.0), VEHICLE, 1_000_000)
    assert abs(state.speed_m_s - (1 - 0.2 * (1 - math.exp(-5)))) < 1e-12
    # still rolling up when the brake comes: up, down and to a stop
    state = advance(EgoState(0.0, 0.0, 0.0, 0.0, 2.0), Control(-2.0, 0.0), VEHICLE, 10_000_000)
    assert state.speed_m_s == 0 and state.x_m > 0
    for least in (5e-324, 1e-200):
        assert advance(EgoState(0.0, 0.0, 0.0, 0.0, least), Control(-least, 0.0), VEHICLE, 20_000).x_m < 1e-100
        assert advance(EgoState(0.0, 0.0, 0.0, 0.0), Control(least, 0.0), VEHICLE, 20_000).x_m < 1e-100


@pytest.mark.parametrize("seed", range(5))
def test_the_same_bits_twice_and_in_halves(seed: int) -> None:
    rng = np.random.default_rng([7, seed])
    for _ in range(20):
        numbers = rng.uniform([-1e3, -1e3, -9, 0, -9, -1], [1e3, 1e3, 9, 4, 5, 1]).tolist()
        start, control = EgoState(*numbers), Control(*rng.uniform([-12, -2], [8, 2]).tolist())
        half = int(rng.integers(1, 60)) * 10_000
        whole = advance(start, control, VEHICLE, 2 * half)
        assert whole == advance(start, control, VEHICLE, 2 * half)
        assert whole == advance(advance(start, control, VEHICLE, half), control, VEHICLE, half)
        assert whole.speed_m_s >= 0 and abs(whole.steering_rad) <= VEHICLE.max_steering_rad


def test_substates_come_every_ten_milliseconds() -> None:
    states = substates(EgoState(0.0, 0.0, 0.0, 1.0), Control(0.0, 0.0), VEHICLE, 34_000)
    assert [time for time, _ in states] == [10_000, 20_000, 30_000, 34_000]
    np.testing.assert_allclose([state.x_m for _, state in states], [0.01, 0.02, 0.03, 0.034])
    start = EgoState(0.0, 0.0, 0.0, 1.0)
    assert (
        substates(start, Control(0.0, 0.0), VEHICLE, 0) == [] and advance(start, Control(1.0, 0.0), VEHICLE, 0) == start
    )


def test_limits_bound_what_is_asked_for() -> None:
    state = advance(EgoState(0.0, 0.0, 0.0, 10.0), Control(1e300, -1e300), VEHICLE, 3_000_000)
    assert abs(state.acceleration_m_s2 - 5) < 1e-5 and abs(state.steering_rad + math.pi / 3) < 1e-12
    assert advance(EgoState(0.0, 0.0, 0.0, 60.0), Control(-1e300, 0.0), VEHICLE, 1_000_000).acceleration_m_s2 > -9


@pytest.mark.parametrize(
    ("state", "duration_us", "message"),
    [
        (EgoState(math.nan, 0.0, 0.0, 0.0), 1, "ego state: x_m must be a finite number, not nan"),
        (EgoState(0.0, 0.0, 0.0, 0.0, math.inf), 1, "ego state: acceleration_m_s2 must be a finite number, not inf"),
        (EgoState(0.0, 0.0, 0.0, -0.5), 1, "ego state: speed_m_s must not be negative, not -0.5"),
        (EgoState(0.0, 0.0, 0.0, 0.0), -1, "duration_us must be whole microseconds, at least 0, not -1"),
    ],
)
def test_faults_are_one_sentence(state: EgoState, duration_us: int, message: str) -> None:
    with pytest.raises(SimulationError) as caught:
        advance(state, Control(0.0, 0.0), VEHICLE, duration_us)
    assert str(caught.value) == message


def test_the_footprint_is_ahead_of_the_rear_axle() -> None:
    vehicle = Vehicle(length_m=5.0, width_m=2.0, rear_overhang_m=1.0)
    print_ = footprint_of(EgoState(1.0, 2.0, math.pi / 2, 3.0, -1.0), vehicle)
    assert (print_.uid, print_.length_m, print_.width_m) == ("ego", 5.0, 2.0)
    assert (print_.speed_m_s, print_.acceleration_m_s2) == (3.0, -1.0)
    # front left, rear left, rear right, front right
    np.testing.assert_allclose(print_.corners, [[0, 6], [0, 1], [2, 1], [2, 6]], atol=1e-12)


AXLE = (-1.3, 0.1, -0.4)


def hills(x: FloatArray, y: FloatArray) -> FloatArray:
    return np.asarray(0.5 * np.sin(x / 20) + 0.05 * y + 3.0)


def above_hills(points: FloatArray) -> FloatArray:
    # as a tracer on float32 rounds it
    return np.asarray(points[:, 2] - hills(points[:, 0], points[:, 1]).astype(np.float32))


def recorded_drive(vehicle: Vehicle, seed: int = 3) -> Trajectory:
    """A bend of a quarter turn at 8 m/s, a second of it standing, with a body that sways."""
    rng = np.random.default_rng(seed)
    times = np.arange(0, 12, 0.1)
    distance = 8 * np.minimum(times, np.maximum(5.0, times - 1.0))
    poses = []
    for s in distance:
        heading = s / 60
        x, y = 60 * math.sin(heading), 60 * (1 - math.cos(heading))
        z = float(hills(np.array(x), np.array(y))) + 0.3 + 0.02 * rng.normal()
        attitude = Attitude(z, 0.03 * rng.normal(), 0.03 * rng.normal())
        poses.append(pose_of(EgoState(x, y, heading, 8.0), attitude, vehicle))
    return Trajectory.from_poses(times, np.array(poses))


def numbers(attitude: Attitude) -> list[float]:
    return [attitude.z_m, attitude.roll_rad, attitude.pitch_rad]


@pytest.mark.parametrize("axle", [(0.0, 0.0, 0.0), AXLE])
def test_state_and_attitude_give_the_pose_back(axle: tuple[float, float, float]) -> None:
    vehicle = Vehicle(rear_axle_m=axle)
    for pose in recorded_drive(vehicle).poses:
        state, attitude = state_of(pose, vehicle, 3.0, 0.5, 0.1)
        np.testing.assert_allclose(pose_of(state, attitude, vehicle), pose, atol=1e-12)
        assert (state.speed_m_s, state.acceleration_m_s2, state.steering_rad) == (3.0, 0.5, 0.1)


def test_signs_of_roll_and_pitch() -> None:
    pose = pose_of(EgoState(1.0, 2.0, math.pi / 2, 0.0), Attitude(3.0, 0.1, 0.2), Vehicle(rear_axle_m=(1.0, 0.0, 0.0)))
    ahead, left = pose[:3, 0], pose[:3, 1]
    assert ahead[2] == pytest.approx(-math.sin(0.2)) and left[2] > 0.09
    np.testing.assert_allclose(pose[:3, 3] + ahead, [1.0, 2.0, 3.0], atol=1e-15)


@pytest.mark.parametrize("axle", [(0.0, 0.0, 0.0), AXLE])
@pytest.mark.parametrize("has_ground", [False, True])
def test_on_a_recorded_pose_the_vehicle_stands_as_recorded(axle: tuple[float, float, float], has_ground: bool) -> None:
    vehicle = Vehicle(rear_axle_m=axle)
    recorded = recorded_drive(vehicle)
    times = np.random.default_rng(1).uniform(0, 11.9, 300)
    # not while it stands, where many heights are recorded at one place
    times = np.append(times[(times < 4.9) | (times > 6.1)], [0.0, 11.9])
    expected = [state_of(pose, vehicle) for pose in recorded.at(times)]
    ground = VehicleGround(recorded, vehicle, above_hills if has_ground else None)
    for (state, wanted), got in zip(expected, ground.attitudes([state for state, _ in expected]), strict=True):
        assert abs(got.z_m - wanted.z_m) < 1e-9
        assert abs(got.roll_rad - wanted.roll_rad) < 1e-9 and abs(got.pitch_rad - wanted.pitch_rad) < 1e-9
        assert got == ground.attitude(state)


def test_beside_the_recorded_drive_the_ground_counts() -> None:
    """A slope that rises by 5 % to the left: a metre to the left is 5 cm higher, and the roll is the recorded one."""
    vehicle = Vehicle()
    times = np.arange(0, 5, 0.5)
    recorded = Trajectory.from_poses(
        times,
        np.array(
            [
                pose_of(EgoState(8 * t, 0.0, 0.0, 8.0), Attitude(0.3, 0.02 + math.atan(0.05), 0.01), vehicle)
                for t in times
            ]
        ),
    )
    ground = VehicleGround(recorded, vehicle, lambda p: p[:, 2] - 0.05 * p[:, 1])
    one = ground.attitude(EgoState(10.0, 1.0, 0.0, 8.0))
    assert one.z_m == pytest.approx(0.35) and one.pitch_rad == pytest.approx(0.01)
    assert one.roll_rad == pytest.approx(0.02 + math.atan(0.05))
    # turned to the left, the slope is ahead: nose up
    turned = ground.attitude(EgoState(10.0, 1.0, math.pi / 2, 8.0))
    assert turned.pitch_rad == pytest.approx(0.01 - math.atan(0.05)) and turned.roll_rad == pytest.approx(0.02)
    level = VehicleGround(recorded, vehicle).attitude(EgoState(10.0, 1.0, 0.0, 8.0))
    assert numbers(level) == pytest.approx([0.3, 0.02 + math.atan(0.05), 0.01])


def test_where_paths_cross_the_one_in_the_vehicles_direction_counts() -> None:
    """A way out at a height of 1 m and back at a height of 2 m."""
    vehicle = Vehicle()
    states = [EgoState(x, 0.0, 0.0, 1.0) for x in (0.0, 5.0, 10.0)] + [
        EgoState(x, 0.2, math.pi, 1.0) for x in (10.0, 0.0)
    ]
    poses = np.array([pose_of(s, Attitude(1.0 if i < 3 else 2.0, 0.0, 0.0), vehicle) for i, s in enumerate(states)])
    ground = VehicleGround(Trajectory.from_poses(np.arange(5.0), poses), vehicle)
    assert ground.attitude(EgoState(6.0, 0.1, 0.0, 1.0)).z_m == pytest.approx(1.0)
    assert ground.attitude(EgoState(6.0, 0.1, -math.pi, 1.0)).z_m == pytest.approx(2.0)


def test_ground_that_is_not_known_leaves_the_recorded_pose() -> None:
    vehicle = Vehicle()
    recorded = recorded_drive(vehicle)
    state = EgoState(10.0, 4.0, 0.2, 1.0)
    unknown = VehicleGround(recorded, vehicle, lambda p: np.where(p[:, 1] > 3, np.nan, p[:, 2]))
    assert unknown.attitude(state) == VehicleGround(recorded, vehicle).attitude(state)


def test_a_recording_of_one_pose() -> None:
    vehicle = Vehicle()
    recorded = Trajectory.from_poses(np.zeros(1), pose_of(EgoState(0, 0, 0, 0), Attitude(1.0, 0.1, 0.2), vehicle)[None])
    for attitude in VehicleGround(recorded, vehicle).attitudes(
        [EgoState(9.0, 9.0, 1.0, 0.0), EgoState(0.0, 0.0, 0.0, 0.0)]
    ):
        assert numbers(attitude) == pytest.approx([1.0, 0.1, 0.2])
