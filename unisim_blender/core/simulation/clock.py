"""When sensors capture in a simulation: every sensor has a period and a phase of its own, integer microseconds."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ..sensors.rays import exposure_window
from ..world.captures import US_PER_SECOND, Capture, microseconds
from ..world.drive import Camera, Drive, Lidar

SUBSTEP_US = 10_000
"""Trajectories of what is simulated have a key at every multiple of it, counted from a step's start."""
CLOSING_US = 1
"""Time from the end of an exposure to one more key: how a pose at the end is interpolated does not depend on what comes
later."""

ROUNDING_US = 1e-3
"""Upper bound, microseconds, of the error that floating point adds to a whole microsecond."""


@dataclass(frozen=True)
class Rate:
    """A sensor captures at ``phase_us`` and every ``period_us`` before and after it."""

    period_us: int
    phase_us: int = 0

    def __post_init__(self) -> None:
        if self.period_us <= 0:
            raise ValueError(f"a sensor's period must be above 0, not {self.period_us} us")

    def from_time(self, time_us: int) -> Iterator[int]:
        """Yield the times of captures from ``time_us`` on."""
        time = self.phase_us + -(-(time_us - self.phase_us) // self.period_us) * self.period_us
        while True:
            yield time
            time += self.period_us


def recorded_rate(sensor: Camera | Lidar) -> Rate:
    """Return the rate at which a sensor was recorded: the median period, and the phase of its first frame. A sensor of one
    frame captures once a second."""
    times = sorted(microseconds(time_s) for time_s in sensor.time_s.values())
    periods = sorted(b - a for a, b in zip(times, times[1:], strict=False))
    return Rate(max(1, periods[len(periods) // 2]) if periods else US_PER_SECOND, times[0] if times else 0)


@dataclass(frozen=True)
class Exposure:
    """A capture, and from when to when its rays leave; integer microseconds that contain the exposure."""

    capture: Capture
    start_us: int
    end_us: int

    @staticmethod
    def of(sensor: Camera | Lidar, capture: Capture) -> Exposure:
        start_s, end_s = exposure_window(sensor, capture.time_s(sensor))
        start, end = start_s * US_PER_SECOND + ROUNDING_US, end_s * US_PER_SECOND - ROUNDING_US
        return Exposure(capture, math.floor(start), math.ceil(end))


def exposures(drive: Drive, rates: Mapping[str, Rate], start_us: int, stop_us: int) -> list[Exposure]:
    """Return the exposures of a simulation from ``start_us`` to ``stop_us``: those that start at ``start_us`` or later and end
    at ``stop_us`` or earlier, by when they end, then by their sensors' names.

    ``rates`` are by the sensors' names; the others capture nothing.
    """
    complete, sensors = [], drive.sensors
    for name, rate in rates.items():
        sensor = sensors[name]
        before, after = _reach(sensor, start_us)
        for time_us in rate.from_time(start_us - after):
            if time_us - before > stop_us:
                break
            exposure = Exposure.of(sensor, Capture.at(sensor, time_us))
            if exposure.start_us >= start_us and exposure.end_us <= stop_us:
                complete.append(exposure)
    return sorted(complete, key=lambda exposure: (exposure.end_us, exposure.capture.sensor_id))


def _reach(sensor: Camera | Lidar, time_us: int) -> tuple[int, int]:
    """Return how much earlier than its time a capture starts at most, and how much later it ends.

    With a margin of a second: read-out times differ from image to image.
    """
    start_s, end_s = exposure_window(sensor, time_us / US_PER_SECOND)
    return (
        time_us - math.floor(start_s * US_PER_SECOND) + US_PER_SECOND,
        math.ceil(end_s * US_PER_SECOND) - time_us + US_PER_SECOND,
    )


def key_times(start_us: int, stop_us: int, during: list[Exposure]) -> list[int]:
    """Return the times after ``start_us`` up to ``stop_us`` at which what is simulated has keys: every 10 ms, and where exposures
    start and end. A key that closes an exposure may lie just behind ``stop_us``."""
    times = {*range(start_us + SUBSTEP_US, stop_us, SUBSTEP_US), stop_us}
    for exposure in during:
        times |= {time for time in (exposure.start_us, exposure.end_us) if start_us < time <= stop_us}
        if start_us < exposure.end_us <= stop_us:
            times.add(exposure.end_us + CLOSING_US)
    return sorted(times)
