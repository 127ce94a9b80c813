"""The recorded vehicle's state at a time: where a simulation starts."""

from __future__ import annotations

import math

import numpy as np

from ...geometry import Trajectory
from ..states import EgoState
from .parameters import Attitude, Vehicle, state_of

WINDOW_S = 0.25
"""Speed, acceleration and steering follow from poses so long before and after: nearer ones tell of their noise."""
LEAST_M = 0.1
"""A vehicle that moves by less in the window does not tell its steering angle."""


def recorded_state(recorded: Trajectory, vehicle: Vehicle, time_s: float) -> tuple[EgoState, Attitude]:
    """Return the state and the attitude at a time of a recorded trajectory of the log's ego frame.

    The pose is the trajectory's. Speed and acceleration are those of a parabola through three places of the rear axle, along
    the arcs between them; a vehicle that rolls backwards has no speed. The steering angle is what the bicycle needs for the
    change of the heading, within the vehicle's limit.
    """
    first, last = float(recorded.times_s[0]), float(recorded.times_s[-1])
    half = min(WINDOW_S, (last - first) / 2)
    if half <= 0:
        return state_of(recorded.at(time_s), vehicle)
    middle = min(max(time_s, first + half), last - half)
    before, here, after = (state_of(recorded.at(middle + one), vehicle)[0] for one in (-half, 0.0, half))
    legs = [_driven_m(before, here), _driven_m(here, after)]
    acceleration = (legs[1] - legs[0]) / half**2
    speed = sum(legs) / (2 * half) + acceleration * (time_s - middle)
    turned = math.remainder(after.heading_rad - before.heading_rad, 2 * math.pi)
    steering = math.atan(vehicle.wheelbase_m * turned / sum(legs)) if sum(legs) > LEAST_M else 0.0
    limit = vehicle.max_steering_rad
    moves = speed > 0
    return state_of(
        recorded.at(time_s),
        vehicle,
        speed if moves else 0.0,
        float(np.clip(acceleration, -vehicle.max_deceleration_m_s2, vehicle.max_acceleration_m_s2)) if moves else 0.0,
        min(max(steering, -limit), limit),
    )


def _driven_m(start: EgoState, end: EgoState) -> float:
    """The length of the arc between two states, negative backwards."""
    half = math.remainder(end.heading_rad - start.heading_rad, 2 * math.pi) / 2
    heading = start.heading_rad + half
    chord = (end.x_m - start.x_m) * math.cos(heading) + (end.y_m - start.y_m) * math.sin(heading)
    return chord * (half / math.sin(half) if half else 1.0)
