"""What is wrong with a number of the vehicle's, in one sentence."""

from __future__ import annotations

import math

from ...errors import SimulationError, short
from ..states import EgoState


def check_number(value: object, place: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a number from ``low`` to ``high``. Raises `SimulationError` that names ``place``."""
    sound = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    if not sound or not low <= value <= high:  # type: ignore[operator]
        bounds = "" if math.isinf(low) and math.isinf(high) else f" from {low:g} to {high:g}"
        raise SimulationError(f"{place} must be a finite number{bounds}, not {short(value)}")
    return float(value)  # type: ignore[arg-type]


def check_state(state: EgoState) -> None:
    """Raise `SimulationError` for a state with a number that is not finite, or a negative speed."""
    for name in ("x_m", "y_m", "heading_rad", "speed_m_s", "acceleration_m_s2", "steering_rad"):
        value = getattr(state, name)
        if not math.isfinite(value):
            raise SimulationError(f"ego state: {name} must be a finite number, not {short(value)}")
    if state.speed_m_s < 0:
        raise SimulationError(f"ego state: speed_m_s must not be negative, not {state.speed_m_s:g}")


def check_microseconds(value: object, place: str, at_least: int) -> int:
    """Return a whole number of microseconds. Raises `SimulationError` that names ``place``."""
    if isinstance(value, bool) or not isinstance(value, int) or value < at_least:
        raise SimulationError(f"{place} must be whole microseconds, at least {at_least}, not {short(value)}")
    return value
