"""How the vehicle moves: a kinematic bicycle about the middle of its rear axle, behind first-order lags.

``x' = v cos(heading)``, ``y' = v sin(heading)``, ``heading' = v curvature``, ``v' = acceleration``; the curvature is
``tan(steering) / wheelbase``, and no more than the limit of the lateral acceleration allows: beyond it the vehicle runs wide
(`Vehicle.curvature`). Acceleration and steering angle approach what is asked for exponentially (Rajamani, "Vehicle Dynamics and
Control", 2nd edition, 2.2). Speed and distance are the closed forms of that. The path of a sub-step is an arc, with the steering
angle of its middle.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from ..states import EgoState
from .actions import Control, check_microseconds, check_state
from .parameters import Vehicle

SUBSTEP_US = 10_000
"""Length of a sub-step, but for the last one."""
HALVINGS = 64
"""Bisections of the time in which the vehicle stops: more do not change it."""


def advance(state: EgoState, control: Control, vehicle: Vehicle, duration_us: int) -> EgoState:
    """Return the state after ``duration_us`` under a control that is held.

    The heading goes on counting past half a turn. The speed is never negative: a vehicle that brakes stops exactly, its
    acceleration is 0 from then on, and it stands until a control accelerates it. The vehicle's limits bound the control. Raises
    `SimulationError` for a state that is not finite or a negative duration.
    """
    states = substates(state, control, vehicle, duration_us)
    return states[-1][1] if states else state


def substates(state: EgoState, control: Control, vehicle: Vehicle, duration_us: int) -> list[tuple[int, EgoState]]:
    """Return the states at the end of each sub-step, with the time since the start in microseconds: every `SUBSTEP_US`, and at
    ``duration_us``; see `advance`."""
    check_state(state)
    duration_us = check_microseconds(duration_us, "duration_us", 0)
    asked = Control(
        min(max(control.acceleration_m_s2, -vehicle.max_deceleration_m_s2), vehicle.max_acceleration_m_s2),
        _within(control.steering_rad, vehicle.max_steering_rad),
    )
    state = replace(state, steering_rad=_within(state.steering_rad, vehicle.max_steering_rad))
    states, time_us = [], 0
    while time_us < duration_us:
        step_us = min(SUBSTEP_US, duration_us - time_us)
        state = _substep(state, asked, vehicle, step_us / 1e6)
        time_us += step_us
        states.append((time_us, state))
    return states


def _substep(state: EgoState, asked: Control, vehicle: Vehicle, duration_s: float) -> EgoState:
    left_s = duration_s
    while left_s > 0:
        if state.speed_m_s == 0 and state.acceleration_m_s2 <= 0:
            state = replace(state, acceleration_m_s2=0.0)
            if asked.acceleration_m_s2 <= 0:
                steering = _Lagged(state.steering_rad, asked.steering_rad, vehicle.steering_lag_s)
                return replace(state, steering_rad=steering.after(left_s))
        pull = _Lagged(state.acceleration_m_s2, asked.acceleration_m_s2, vehicle.acceleration_lag_s)
        stop_s = _time_of_stop(state.speed_m_s, pull, left_s)
        state = _moved(state, pull, asked.steering_rad, vehicle, left_s if stop_s is None else stop_s)
        if stop_s is None:
            return state
        state = replace(state, speed_m_s=0.0, acceleration_m_s2=0.0)
        left_s -= stop_s
    return state


def _moved(state: EgoState, pull: _Lagged, steering_rad: float, vehicle: Vehicle, duration_s: float) -> EgoState:
    steering = _Lagged(state.steering_rad, steering_rad, vehicle.steering_lag_s)
    distance = max(state.speed_m_s * duration_s + pull.twice_integrated(duration_s), 0.0)
    angle = steering.after(duration_s / 2)
    later = max(state.speed_m_s + pull.integrated(duration_s), 0.0)
    fastest = max(state.speed_m_s, later)
    half = distance * math.tan(angle) / vehicle.wheelbase_m / 2
    if vehicle.slides(angle, fastest):
        half = distance * vehicle.curvature(angle, fastest) / 2
    chord = distance * (math.sin(half) / half if half else 1.0)
    return EgoState(
        state.x_m + chord * math.cos(state.heading_rad + half),
        state.y_m + chord * math.sin(state.heading_rad + half),
        state.heading_rad + 2 * half,
        later,
        pull.after(duration_s),
        steering.after(duration_s),
    )


@dataclass(frozen=True)
class _Lagged:
    """A value that approaches what is asked for: ``asked + (now - asked) exp(-t / lag)``."""

    now: float
    asked: float
    lag_s: float

    def after(self, t: float) -> float:
        """The value after a time."""
        return self.asked + (self.now - self.asked) * math.exp(-t / self.lag_s) if self.lag_s else self.asked

    def integrated(self, t: float) -> float:
        """The integral of the value over a time."""
        lagging = -self.lag_s * math.expm1(-t / self.lag_s) if self.lag_s else 0.0
        return self.asked * t + (self.now - self.asked) * lagging

    def twice_integrated(self, t: float) -> float:
        lagging = self.lag_s * (t + self.lag_s * math.expm1(-t / self.lag_s)) if self.lag_s else 0.0
        return self.asked * t * t / 2 + (self.now - self.asked) * lagging

    def time_of_zero(self) -> float | None:
        """When the value changes its sign; None where it never does."""
        if self.now * self.asked >= 0 or not self.lag_s:
            return None
        return self.lag_s * math.log1p(-self.now / self.asked)


def _time_of_stop(speed: float, pull: _Lagged, duration_s: float) -> float | None:
    """When the speed reaches 0 within the duration; None where it does not."""
    if pull.now >= 0 and pull.asked >= 0:
        return None
    turn = pull.time_of_zero()
    low, high = 0.0, duration_s
    if turn is not None and turn < duration_s:
        low, high = (turn, duration_s) if pull.now > 0 else (0.0, turn)
    if speed + pull.integrated(high) > 0:
        return None
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        if not low < middle < high:
            break
        if speed + pull.integrated(middle) > 0:
            low = middle
        else:
            high = middle
    return high


def _within(angle_rad: float, limit_rad: float) -> float:
    return min(max(angle_rad, -limit_rad), limit_rad)
