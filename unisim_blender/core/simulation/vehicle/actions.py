"""What a driver asks of the vehicle: a control, or a plan that is tracked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import SimulationError, short
from ...geometry import FloatArray
from ...world.captures import MOST_US
from .checks import array_of, check_number


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


def _near(times: NDArray[Any]) -> bool:
    return -MOST_US <= int(times.min()) and int(times.max()) <= MOST_US


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
