"""How the ego drove: its progress along the route, its comfort, and the consistency of its plans.

Comfort is by PDM's limits on accelerations, jerks and rates of yaw. Consistency is the distance between successive plans.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import FloatArray, Trajectory, rotate_vectors
from ...world.polyline import Polyline, spaced
from ..footprints import directions
from .record import PlanRecord, Record

COUNTS_FROM_M = 5.0
"""A recorded distance below it is no progress to compare with (NAVSIM and AlpaSim)."""
LEAST_SEGMENT_M = 0.05
"""Keys that are nearer to the last one are left out: where the vehicle stands, the noise of its poses is no path."""
NOT_RECORDED = "no step lies within the log's times"


@dataclass(frozen=True)
class RouteProgress:
    """``share`` of the recorded distance, 0 to 1, and 1 where that is below 5 m; ``distance_m`` that the ego got
    along the recorded path, ``recorded_distance_m`` that the log's ego did in the same time. What is None has a
    ``reason``."""

    share: float | None = None
    distance_m: float | None = None
    recorded_distance_m: float | None = None
    reason: str | None = None


@dataclass(frozen=True)
class Deviation:
    """How far the ego was from where the log's ego was at the same time: ``along`` the recorded path, where ahead is
    positive, and ``across`` from the path, where left is positive. Greatest and mean lengths over the steps, and the
    last. What is None has a ``reason``."""

    along_max_m: float | None = None
    along_mean_m: float | None = None
    along_last_m: float | None = None
    across_max_m: float | None = None
    across_mean_m: float | None = None
    across_last_m: float | None = None
    reason: str | None = None


@dataclass(frozen=True)
class PathPlaces:
    """Where the ego was along and across the recorded path (T,), and where along it the log's ego was (T,); metres.
    Steps outside the log's times have the log's ego at the path's ends."""

    along_m: FloatArray
    across_m: FloatArray
    recorded_along_m: FloatArray


def recorded_path(trajectory: Trajectory) -> Polyline:
    """The path that a trajectory takes in the plane."""
    forward = rotate_vectors(trajectory.poses, np.array([[1.0, 0.0, 0.0]]))[:, 0]
    headings = np.arctan2(forward[:, 1], forward[:, 0])
    return path_through(trajectory.positions[:, :2], float(headings[0]), float(headings[-1]))


def path_through(positions: FloatArray, first_heading_rad: float, last_heading_rad: float) -> Polyline:
    """The path through positions (K, 2) in order; it goes on along the headings at its ends."""
    points = np.asarray(positions[spaced(positions, LEAST_SEGMENT_M)], np.float64)
    before, after = directions(np.array([first_heading_rad, last_heading_rad]))
    if len(points) > 1:  # a vehicle that backs up goes against its heading
        before = np.copysign(1.0, (points[1] - points[0]) @ before) * before
        after = np.copysign(1.0, (points[-1] - points[-2]) @ after) * after
    return Polyline.through(points, before, after)


def path_places(record: Record) -> PathPlaces:
    """Where the ego and the log's ego were along the recorded path. Both are followed from step to step, so a path
    that crosses itself is not jumped along."""
    log = record.recorded_ego
    path = recorded_path(log)
    recorded = log.positions_at(np.clip(record.times_s, log.times_s[0], log.times_s[-1]))[:, :2]
    # where along the path the log's ego is at first: as far as it went until then
    until = np.concatenate([log.positions[log.times_s < record.times_s[0], :2], recorded[:1]])
    start_m = min(float(np.linalg.norm(np.diff(until, axis=0), axis=-1).sum()), path.length_m)
    recorded_along, _ = path.follow(recorded, start_m)
    along, across = path.follow(record.ego_axle[:, :2], float(recorded_along[0]))
    return PathPlaces(along, across, recorded_along)


def progress(record: Record, places: PathPlaces) -> RouteProgress:
    """The share of the recorded distance that the ego made, as NAVSIM and AlpaSim have it: the driven distance along
    the recorded path over what the log's ego went in the same time."""
    if len(record.times_s) < 2:
        return RouteProgress(reason="progress needs two steps, and there is one")
    if not record.recorded_times.any():
        return RouteProgress(reason=NOT_RECORDED)
    distance = float(places.along_m[-1] - places.along_m[0])
    recorded = float(places.recorded_along_m[-1] - places.recorded_along_m[0])
    share = 1.0 if recorded < COUNTS_FROM_M else float(np.clip(distance / recorded, 0.0, 1.0))
    return RouteProgress(share, distance, recorded)


def deviation(record: Record, places: PathPlaces) -> Deviation:
    """How far the ego was from the log, over the steps within the log's times."""
    compared = record.recorded_times
    if not compared.any():
        return Deviation(reason=NOT_RECORDED)
    along, across = (places.along_m - places.recorded_along_m)[compared], places.across_m[compared]
    return Deviation(
        along_max_m=float(np.abs(along).max()),
        along_mean_m=float(np.abs(along).mean()),
        along_last_m=float(along[-1]),
        across_max_m=float(np.abs(across).max()),
        across_mean_m=float(np.abs(across).mean()),
        across_last_m=float(across[-1]),
    )


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
    measured = rates(record.times_s, record.ego_speeds, record.ego_axle[:, 2])
    middles = (record.times_s[1:] + record.times_s[:-1]) / 2
    ranges = {
        name: _range(values, *LIMITS[name], middles if len(values) == len(middles) else record.times_s[1:-1])
        for name, values in measured.items()
    }
    return Comfort(all(quantity.within for quantity in ranges.values()), ranges)


def rates(times_s: FloatArray, speeds_m_s: FloatArray, headings_rad: FloatArray) -> dict[str, FloatArray]:
    """Return the quantities that `LIMITS` are for, of speeds (T,) and headings (T,) at times (T,), T >= 3.

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


def is_comfortable(rates: dict[str, FloatArray]) -> bool:
    """Whether quantities of `rates` are all within their limits."""
    return all(_range(values, *LIMITS[name]).within for name, values in rates.items())


def _range(values: FloatArray, lowest: float, highest: float, times_s: FloatArray | None = None) -> ComfortRange:
    least, greatest = float(values.min()), float(values.max())
    outside = np.flatnonzero((values < lowest - ROUNDING) | (values > highest + ROUNDING))
    first_s = float(times_s[outside[0]]) if times_s is not None and len(outside) else None
    return ComfortRange(least, greatest, not len(outside), first_s)


DECAY_S = 1.0
"""A planned position this much later weighs 1/e as much."""
END_S = 5.0
"""UniSim compares plans by their positions after this time."""


@dataclass(frozen=True)
class PlanConsistency:
    """Over the ``pairs`` of successive plans that share times: mean and greatest distance, near positions weighing
    more; and the mean distance after 5 s, over the ``end_pairs`` that reach so far. What is None has a ``reason``."""

    mean_m: float | None = None
    max_m: float | None = None
    pairs: int = 0
    end_point_mean_m: float | None = None
    end_pairs: int = 0
    reason: str | None = None


def plan_consistency(record: Record) -> PlanConsistency:
    """Distances between successive plans.

    As AlpaSim's plan deviation: the later plan's positions after the time it was made at, up to the earlier plan's
    end, against the earlier plan's at the same times, averaged with weights that decay exponentially. AlpaSim's
    weights decay by the number of the position; these by its time, over `DECAY_S`, so plans of any spacing compare.
    The distance after 5 s is UniSim's plan consistency (Yang et al., CVPR 2023, supplementary 4.5), there between
    plans on real and simulated data.
    """
    if not record.plans:
        return PlanConsistency(reason="the driver gave no plans")
    if len(record.plans) < 2:
        return PlanConsistency(reason="the driver gave one plan alone")
    pairs = list(zip(record.plans, record.plans[1:], strict=False))
    distances = [apart for pair in pairs if (apart := _plan_distance(*pair)) is not None]
    ends = [apart for pair in pairs if (apart := _end_distance(*pair)) is not None]
    if not distances:
        return PlanConsistency(reason="no two successive plans share a time")
    return PlanConsistency(
        mean_m=float(np.mean(distances)),
        max_m=float(np.max(distances)),
        pairs=len(distances),
        end_point_mean_m=float(np.mean(ends)) if ends else None,
        end_pairs=len(ends),
        reason=None if ends else f"no two successive plans reach {END_S:g} s ahead",
    )


def _plan_distance(earlier: PlanRecord, later: PlanRecord) -> float | None:
    times = later.times_us[(later.times_us > later.planned_us) & (later.times_us <= earlier.times_us[-1])]
    times = times[times >= earlier.times_us[0]]
    if not len(times):
        return None
    apart = np.linalg.norm(_positions(later, times / 1e6) - _positions(earlier, times / 1e6), axis=-1)
    weights = np.exp(-(times - later.planned_us) / 1e6 / DECAY_S)
    if not weights.sum() > 0:  # all so late that their weights vanish
        return None
    return float((weights * apart).sum() / weights.sum())


def _end_distance(earlier: PlanRecord, later: PlanRecord) -> float | None:
    end_us = later.planned_us + round(END_S * 1e6)
    if any(end_us > plan.times_us[-1] or end_us < plan.times_us[0] for plan in (earlier, later)):
        return None
    end_s = np.array([end_us / 1e6])
    return float(np.linalg.norm(_positions(later, end_s) - _positions(earlier, end_s)))


def _positions(plan: PlanRecord, times_s: FloatArray) -> FloatArray:
    """Planned positions (N, 2) at times (N,), linear between the plan's."""
    return np.stack([np.interp(times_s, plan.times_us / 1e6, plan.poses[:, axis]) for axis in (0, 1)], -1)
