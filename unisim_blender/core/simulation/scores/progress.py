"""How far the ego got along the recorded path, and how far from the log it went."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...geometry import FloatArray, Trajectory, rotate_vectors
from ...world.polyline import Polyline, spaced
from .footprints import directions
from .record import Record

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
