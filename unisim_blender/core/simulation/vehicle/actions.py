"""The actions that a driver answers with, a control or a plan that is tracked, and the checks of their numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SimulationError, short
from ...geometry import FloatArray
from ...world.captures import MAX_TIME_US
from ..states import EgoState


@dataclass(frozen=True)
class Control:
    """An acceleration along the heading, m/s² (braking is negative), and an angle of the front wheels, radians (left is
    positive), that the vehicle is to take on.

    Numbers of Python, numpy and torch, or arrays of one. Raises `SimulationError` for what is no finite number. The vehicle's
    own limits are applied where it moves.
    """

    acceleration_m_s2: float
    steering_rad: float

    def __post_init__(self) -> None:
        for name in ("acceleration_m_s2", "steering_rad"):
            object.__setattr__(self, name, check_number(getattr(self, name), f"control: {name}"))


@dataclass(frozen=True, eq=False)
class Plan:
    """Where the middle of the rear axle is to be: poses at ``times_us`` (T,), strictly increasing, T >= 1.

    Times are integer microseconds from the log's first frame, as `Observation.time_us`. ``x_m``, ``y_m`` (T,) are metres in the
    world frame, not in the vehicle's; ``heading_rad`` (T,) are counter-clockwise from the world's x. ``speed_m_s`` (T,), not
    negative, is along the headings; where it is None, it follows from the poses. After its last pose the vehicle brakes to a
    stop.

    Lists, numpy's arrays or torch's tensors, which are copied. Raises `SimulationError` for other shapes, for what is no finite
    number, and for times that do not increase.
    """

    times_us: NDArray[np.int64]
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    speed_m_s: FloatArray | None = None

    def __post_init__(self) -> None:
        times = array_of(self.times_us)
        if times is None or times.ndim != 1 or len(times) == 0 or times.dtype.kind == "f" or not _near(times):
            raise SimulationError(
                f"plan: times_us must be a list of whole microseconds, one at least, not {short(self.times_us)}"
            )
        object.__setattr__(self, "times_us", times.astype(np.int64))
        late = np.flatnonzero(np.diff(self.times_us) <= 0)
        if len(late):
            before, after = self.times_us[late[0] : late[0] + 2].tolist()
            raise SimulationError(
                f"plan: pose {late[0] + 1} at {after} us is not later than the one before, at {before} us"
            )
        for name in ("x_m", "y_m", "heading_rad", "speed_m_s"):
            if name != "speed_m_s" or self.speed_m_s is not None:
                object.__setattr__(self, name, _numbers(getattr(self, name), name, len(times)))
        if self.speed_m_s is not None and (self.speed_m_s < 0).any():
            pose = int((self.speed_m_s < 0).argmax())
            raise SimulationError(f"plan: speed_m_s of pose {pose} must not be negative, not {self.speed_m_s[pose]:g}")

    @staticmethod
    def at_rest(time_us: int, ego: EgoState) -> Plan:
        """Return the plan to stop where the vehicle is."""
        heading = math.remainder(ego.heading_rad, math.tau)
        return Plan(np.array([time_us]), np.array([ego.x_m]), np.array([ego.y_m]), np.array([heading]), np.zeros(1))


def _near(times: NDArray[Any]) -> bool:
    return -MAX_TIME_US <= int(times.min()) and int(times.max()) <= MAX_TIME_US


def _numbers(values: object, name: str, count: int) -> FloatArray:
    array = array_of(values)  # a copy: a driver may use its arrays again
    if array is None:
        raise SimulationError(f"plan: {name} must be {count} numbers, not {short(values)}")
    array = array.astype(np.float64)
    if array.shape != (count,):
        raise SimulationError(f"plan: {name} must be {count} numbers, as many as times_us, not of shape {array.shape}")
    finite = np.isfinite(array)
    if not finite.all():
        pose = int(finite.argmin())
        raise SimulationError(f"plan: {name} of pose {pose} must be a finite number, not {array[pose]}")
    return array


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
        if isinstance(values, list | tuple) and not all(type(value) in (int, float) for value in values):
            parts = [array_of(value) for value in values]
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
