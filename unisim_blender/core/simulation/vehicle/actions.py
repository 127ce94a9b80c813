"""What a driver asks of the vehicle: a control, or a plan that is tracked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...errors import SimulationError, short
from ...geometry import FloatArray
from .checks import check_number


@dataclass(frozen=True)
class Control:
    """An acceleration along the heading and an angle of the front wheels (left is positive) that the vehicle is to take on.

    Raises `SimulationError` for numbers that are not finite. The vehicle's own limits are applied where it moves.
    """

    acceleration_m_s2: float
    steering_rad: float

    def __post_init__(self) -> None:
        for name in ("acceleration_m_s2", "steering_rad"):
            object.__setattr__(self, name, check_number(getattr(self, name), f"control: {name}"))


@dataclass(frozen=True, eq=False)
class Plan:
    """Where the middle of the rear axle is to be: poses at ``times_us`` (T,), strictly increasing, T >= 1.

    x_m, y_m, heading_rad (T,), world frame. ``speed_m_s`` (T,), not negative, is along the headings; where it is None, it
    follows from the poses. Raises `SimulationError` for arrays of other shapes, numbers that are not finite and times that do
    not increase.
    """

    times_us: NDArray[np.int64]
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    speed_m_s: FloatArray | None = None

    def __post_init__(self) -> None:
        times = np.asarray(self.times_us)
        if times.ndim != 1 or len(times) == 0 or times.dtype.kind not in "iu":
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


def _numbers(values: object, name: str, count: int) -> FloatArray:
    try:
        array = np.asarray(values, np.float64)
    except (TypeError, ValueError):
        raise SimulationError(f"plan: {name} must be {count} numbers, not {short(values)}") from None
    if array.shape != (count,):
        raise SimulationError(f"plan: {name} must be {count} numbers, as many as times_us, not of shape {array.shape}")
    finite = np.isfinite(array)
    if not finite.all():
        pose = int(finite.argmin())
        raise SimulationError(f"plan: {name} of pose {pose} must be a finite number, not {array[pose]}")
    return array
