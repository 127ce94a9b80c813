"""Comfort by PDM's limits on accelerations, jerks and rates of yaw."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import FloatArray
from .record import Record

LIMITS: dict[str, tuple[float, float]] = {
    "longitudinal_acceleration_m_s2": (-4.05, 2.40),
    "lateral_acceleration_m_s2": (-4.89, 4.89),
    "jerk_m_s3": (-8.37, 8.37),
    "longitudinal_jerk_m_s3": (-4.13, 4.13),
    "yaw_rate_rad_s": (-0.95, 0.95),
    "yaw_acceleration_rad_s2": (-1.93, 1.93),
}
"""nuPlan's and NAVSIM's (`pdm_comfort_metrics`)."""
ROUNDING = 1e-8
"""NAVSIM rounds to this before it compares, so a value at its limit is within."""
LEAST_STEPS = 3


@dataclass(frozen=True)
class ComfortRange:
    """The least and the greatest value of a quantity, whether both are within its limits, and the first time at which it is
    not, where times are known."""

    least: float
    greatest: float
    within: bool
    exceeded_at_s: float | None = None


@dataclass(frozen=True)
class Comfort:
    """``comfortable``: every quantity is within its limits at all times. ``ranges`` by the names of `LIMITS`. What is
    None has a ``reason``."""

    comfortable: bool | None = None
    ranges: dict[str, ComfortRange] | None = None
    reason: str | None = None


def comfort(record: Record) -> Comfort:
    """Comfort of the drive, from the ego's own speeds and headings (`rates`)."""
    if len(record.times_s) < LEAST_STEPS:
        return Comfort(reason=f"jerk needs {LEAST_STEPS} steps, and there are {len(record.times_s)}")
    found = rates(record.times_s, record.ego_speeds, record.ego_axle[:, 2])
    middles = (record.times_s[1:] + record.times_s[:-1]) / 2
    ranges = {
        name: _range(values, *LIMITS[name], middles if len(values) == len(middles) else record.times_s[1:-1])
        for name, values in found.items()
    }
    return Comfort(all(one.within for one in ranges.values()), ranges)


def rates(times_s: FloatArray, speeds_m_s: FloatArray, headings_rad: FloatArray) -> dict[str, FloatArray]:
    """What `LIMITS` are for, of speeds (T,) and headings (T,) at times (T,), T >= 3.

    Plain differences, nothing is smoothed: in the middle of each interval of time the longitudinal acceleration is
    the difference of the speeds over its duration, the yaw rate that of the headings, and the lateral acceleration
    the mean speed times the yaw rate (T - 1 values each). Jerks and the yaw acceleration are the differences of
    neighbouring ones of these over the time between the middles (T - 2). ``jerk_m_s3`` is the change of the
    acceleration's length, as in NAVSIM. NAVSIM fits its accelerations and derivatives by Savitzky and Golay's filter,
    which hides short peaks; these do not.
    """
    duration = np.diff(times_s)
    longitudinal = np.diff(speeds_m_s) / duration
    yaw_rate = np.diff(np.unwrap(headings_rad)) / duration
    lateral = (speeds_m_s[1:] + speeds_m_s[:-1]) / 2 * yaw_rate
    spacing = (duration[1:] + duration[:-1]) / 2
    return {
        "longitudinal_acceleration_m_s2": longitudinal,
        "lateral_acceleration_m_s2": lateral,
        "jerk_m_s3": np.diff(np.hypot(longitudinal, lateral)) / spacing,
        "longitudinal_jerk_m_s3": np.diff(longitudinal) / spacing,
        "yaw_rate_rad_s": yaw_rate,
        "yaw_acceleration_rad_s2": np.diff(yaw_rate) / spacing,
    }


def is_comfortable(found: dict[str, FloatArray]) -> bool:
    """Whether quantities of `rates` are all within their limits."""
    return all(_range(values, *LIMITS[name]).within for name, values in found.items())


def _range(values: FloatArray, lowest: float, highest: float, times_s: FloatArray | None = None) -> ComfortRange:
    least, greatest = float(values.min()), float(values.max())
    outside = np.flatnonzero((values < lowest - ROUNDING) | (values > highest + ROUNDING))
    first_s = float(times_s[outside[0]]) if times_s is not None and len(outside) else None
    return ComfortRange(least, greatest, not len(outside), first_s)
