"""States of a recorded drive against those that the recording was made of."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unisim_blender.core.geometry import Trajectory
from unisim_blender.core.simulation.states import EgoState
from unisim_blender.core.simulation.vehicle.actions import Control
from unisim_blender.core.simulation.vehicle.bicycle import substates
from unisim_blender.core.simulation.vehicle.parameters import Attitude, Vehicle, pose_of
from unisim_blender.core.simulation.vehicle.recorded import recorded_state

VEHICLE = Vehicle(rear_axle_m=(-1.2, 0.0, -0.3))
ATTITUDE = Attitude(0.5, 0.01, -0.02)


def recording(states: list[EgoState], every_s: float) -> Trajectory:
    return Trajectory.from_poses(
        every_s * np.arange(len(states)), np.array([pose_of(one, ATTITUDE, VEHICLE) for one in states])
    )


@pytest.mark.parametrize(("speed", "acceleration", "steering"), [(8.0, 0.0, 0.1), (3.0, 1.5, -0.3), (9.0, -2.0, 0.0)])
def test_the_state_that_was_driven(speed: float, acceleration: float, steering: float) -> None:
    start = EgoState(10.0, -5.0, 3.0, speed, acceleration, steering)
    states = [start, *(one for _, one in substates(start, Control(acceleration, steering), VEHICLE, 3_000_000))]
    recorded = recording(states, 0.01)
    for step in (0, 10, 100, 250, 300):
        found, attitude = recorded_state(recorded, VEHICLE, step / 100)
        expected = states[step]
        assert math.hypot(found.x_m - expected.x_m, found.y_m - expected.y_m) < 1e-9
        assert abs(math.remainder(found.heading_rad - expected.heading_rad, 2 * math.pi)) < 1e-9
        assert abs(found.speed_m_s - expected.speed_m_s) < 1e-3
        assert abs(found.acceleration_m_s2 - acceleration) < 1e-3 and abs(found.steering_rad - steering) < 1e-3
        assert attitude.z_m == pytest.approx(0.5) and attitude.pitch_rad == pytest.approx(-0.02)


def test_a_vehicle_that_stands_or_rolls_back_has_no_speed() -> None:
    for step in (0.0, -0.02):
        found, _ = recorded_state(recording([EgoState(step * i, 0, 0, 0) for i in range(20)], 0.1), VEHICLE, 1.0)
        assert (found.speed_m_s, found.acceleration_m_s2, found.steering_rad) == (0.0, 0.0, 0.0)


def test_a_recording_of_one_pose_stands() -> None:
    found, _ = recorded_state(recording([EgoState(1.0, 2.0, 0.5, 0)], 0.1), VEHICLE, 7.0)
    assert (found.x_m, found.y_m, found.speed_m_s) == (pytest.approx(1), pytest.approx(2), 0.0)
