"""What is wrong with a number of the vehicle's, in one sentence."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SimulationError, short
from ..states import EgoState

NUMERIC = "iuf"
"""Kinds of numpy's types that are real numbers: neither booleans, complex numbers, strings nor dates."""


def array_of(values: object) -> NDArray[Any] | None:
    """Return a copy of real numbers as an array: numbers of Python, numpy or torch (on any device), and nested lists of them.
    None for what is anything else, or has masked elements."""
    try:
        if hasattr(
            values, "detach"
        ):  # torch's, of which numpy takes neither gradients, other devices nor half of the types
            tensor: Any = values.detach().cpu()
            values = tensor.double().numpy() if tensor.is_floating_point() else tensor.numpy()
        if isinstance(values, list | tuple) and not all(type(one) in (int, float) for one in values):
            parts = [array_of(one) for one in values]
            if any(part is None for part in parts):
                return None
            return np.array(parts)
        if not hasattr(values, "dtype") and hasattr(
            values, "__float__"
        ):  # fractions, decimals, whole numbers of any length
            array = np.array(values)
            return (
                array if array.dtype.kind in NUMERIC else None if array.dtype.kind != "O" else np.array(float(values))
            )
        array = np.array(values)
        mask: Any = getattr(values, "mask", False)  # of a masked array, whose copy has what lies beneath
        return None if array.dtype.kind not in NUMERIC or np.any(mask) else array
    except (TypeError, ValueError, OverflowError, RuntimeError):
        return None


def check_number(value: object, place: str, low: float = -math.inf, high: float = math.inf) -> float:
    """Return a number from ``low`` to ``high``, of Python, numpy or torch, or an array of one. Raises `SimulationError` that
    names ``place``."""
    array = np.array(value) if type(value) is float else None if isinstance(value, list | tuple) else array_of(value)
    number = math.nan if array is None or array.size != 1 else float(array.item())
    if not math.isfinite(number) or not low <= number <= high:
        bounds = "" if math.isinf(low) and math.isinf(high) else f" from {low:g} to {high:g}"
        raise SimulationError(f"{place} must be a finite number{bounds}, not {short(value)}")
    return number


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
    array = array_of(value)
    if array is None or array.size != 1 or array.dtype.kind == "f" or array.item() < at_least:
        raise SimulationError(f"{place} must be whole microseconds, at least {at_least}, not {short(value)}")
    return int(array.item())
