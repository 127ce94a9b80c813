"""Height, roll and pitch: on the recorded drive as recorded, beside it by the ground."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray, Trajectory
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.ground import VehicleGround
from unisim_blender.core.simulation.vehicle.parameters import Attitude, Vehicle, pose_of, state_of

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
