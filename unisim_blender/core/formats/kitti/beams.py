"""The beams and the spin of an HDL-64E, estimated from its sweeps: points come ring by ring, the upper one first,
without ring or time.

Rings are told by wraps of azimuth. The beams do not meet in a point: beam k's points lie on the line ``z = height[k] + distance *
tan(elevation[k])``, distance from the sensor's axis. On recorded sweeps of 2011-09-26 a line leaves 0.002 to 0.006 degrees, where
elevations as seen from the sensor's origin differ by up to 4 degrees along a ring; heights are 0.116 to 0.209 m.

The spin tells when each point was taken: planes of two sweeps fall on each other for the right one.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray, Trajectory, placed
from ...world.drive import LidarModel

WORDS = {1: "counter-clockwise", -1: "clockwise"}
_Placed = tuple[FloatArray, FloatArray, FloatArray]
Turn = tuple[float, float, float]
"""When the LiDAR looked backward, forward and backward again, seconds."""
Turns = tuple[FloatArray, FloatArray, FloatArray]
"""Of each of some points, its own turn."""
USUAL = -1
"""Clockwise seen from above: taken where the recording does not tell. KITTI's text states the other way, but sweeps of its
drives lie on each other best so, by halves and at every lag (docs/measurements/layouts.md)."""
APART, PAIRS = 3, 8
"""Sweeps of a pair are so many frames apart; the fastest pairs of the drive are looked at, at most so many."""
CELL_M, AGREE = 0.3, 0.95
"""Points of two sweeps in a cell of this size, whose normals have this cosine, are taken to lie on one plane."""
ACROSS = 0.3
"""Planes tell of the time by which the sensor moved across them: the cosine of its way with their normal is at least this."""
LEAST_PAIR_POINTS = 30
"""Points of a pair that tell a spin."""
SURE = 4.0
"""A spin that is fewer standard errors from 0 is not told."""
OFF = 0.6
"""Nor is one further than this from 1 and -1, of the whole or of a half."""


@dataclass(frozen=True)
class Spin:
    """A direction (1: counter-clockwise), whether the recording tells it, and the sentence that says so."""

    direction: int
    is_measured: bool
    sentence: str


@dataclass(frozen=True)
class PlanePoints:
    """Points on planes, and the planes' normals (N, 3), in the sensor's frame at each point's own time."""

    points: FloatArray
    normals: FloatArray


def point_times(points: FloatArray, turn: Turn | Turns, spin: float) -> FloatArray:
    """Return when each point (N, 3+) was taken (N,): by its azimuth; all at once in a turn for ``spin`` 0."""
    fraction = spin * np.arctan2(points[:, 1], points[:, 0]) / np.pi  # -1 as the turn starts, 1 as it ends
    start, forward, end = turn
    return np.asarray(forward + np.where(fraction < 0, fraction * (forward - start), fraction * (end - forward)))


def fit_spin(
    frames: Sequence[int], read: Callable[[int], PlanePoints], turns: dict[int, Turn], track: Trajectory
) -> Spin:
    """Return the spin that the sweeps of ``frames`` tell, whose sensor's world poses are ``track``."""
    pairs = [(frames[at], frames[at + APART]) for at in range(len(frames) - APART)]
    moved = [np.linalg.norm(np.subtract(*track.positions_at(np.array([turns[a][1], turns[b][1]])))) for a, b in pairs]
    chosen = sorted(pairs[at] for at in np.argsort(np.negative(moved), kind="stable")[:PAIRS])
    where: dict[int, _Placed] = {}
    spins = []
    for pair in chosen:
        for frame in pair:
            if frame not in where:
                where[frame] = _place(read(frame), turns[frame], track)
        spin = _spin_of(where[pair[0]], where[pair[1]])
        if spin is not None:
            spins.append(spin)
    return decide(np.array(spins))


def decide(spins: FloatArray) -> Spin:
    """Return what the spins (K,) of pairs of sweeps, in order of time, tell together."""
    if len(spins) < 2:
        return Spin(
            USUAL, False, f"nothing tells which way the LiDAR turns: {WORDS[USUAL]} is taken, as KITTI's sensor does"
        )
    # pairs share sweeps, so they tell less than so many independent ones
    middle, error = float(np.median(spins)), float(1.4826 * np.median(np.abs(spins - np.median(spins))))
    error = max(error / np.sqrt(len(spins) / APART), 0.01)
    fitted = f"{middle:+.2f} ± {error:.2f}, where +1 is counter-clockwise and -1 clockwise"
    direction = 1 if middle > 0 else -1
    if abs(middle) < SURE * error or abs(abs(middle) - 1) > OFF:
        why = f"the sweeps do not tell which way the LiDAR turns (fitted spin {fitted}; a slow drive, or poses that do not fit)"
        return Spin(USUAL, False, f"{why}: {WORDS[USUAL]} is taken, as KITTI's sensor does")
    halves = [float(np.median(half)) for half in np.array_split(spins, 2)]
    if max(abs(half - direction) for half in halves) > OFF:
        why = (
            f"the halves of the drive contradict each other on which way the LiDAR turns (fitted spins {halves[0]:+.2f} and "
            f"{halves[1]:+.2f})"
        )
        return Spin(USUAL, False, f"{why}: {WORDS[USUAL]} is taken, as KITTI's sensor does")
    return Spin(direction, True, f"the LiDAR turns {WORDS[direction]} (fitted spin {fitted})")


def _place(planes: PlanePoints, turn: Turn, track: Trajectory) -> _Placed:
    """Points in the world for spin 0, by how much spin moves them, and their normals there: (N, 3) each."""
    ends = []
    for spin in (1.0, -1.0):
        ends.append(placed(track, planes.points, point_times(planes.points, turn, spin)))
    normals = planes.normals @ track.at(turn[1])[:3, :3].T
    return (ends[0] + ends[1]) / 2, (ends[0] - ends[1]) / 2, normals


def _spin_of(first: _Placed, second: _Placed) -> float | None:
    """The spin for which the planes of two sweeps fall on each other best; None where too few tell."""
    rows, other_rows = _same_cells(first[0], second[0])
    normal = first[2][rows]
    agree = np.sum(normal * second[2][other_rows], 1) > AGREE
    moves = second[1][other_rows] - first[1][rows]
    apart = np.sum(normal * (second[0][other_rows] - first[0][rows]), 1)
    lever = np.sum(normal * moves, 1)
    used = agree & (np.abs(lever) > ACROSS * np.linalg.norm(moves, axis=1))
    if used.sum() < LEAST_PAIR_POINTS:
        return None
    return _slope(lever[used], -apart[used])


def _same_cells(first: FloatArray, second: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Indices of points (N, 3) and (M, 3) that share a cell, one of each a cell."""
    low = np.minimum(first.min(0, initial=np.inf), second.min(0, initial=np.inf))
    cells = [np.floor((points - low) / CELL_M).astype(np.int64) for points in (first, second)]
    span = np.maximum(cells[0].max(0, initial=0), cells[1].max(0, initial=0)) + 1
    keys = [(cell[:, 0] * span[1] + cell[:, 1]) * span[2] + cell[:, 2] for cell in cells]
    _, rows, other_rows = np.intersect1d(keys[0], keys[1], return_indices=True)
    return rows, other_rows


def _slope(x: FloatArray, y: FloatArray) -> float:
    """The slope of y over x through the origin, least squares with Tukey's weights."""
    slope = 0.0
    for _ in range(10):
        off = y - slope * x
        scale = max(4.7 * 1.4826 * float(np.median(np.abs(off))), 1e-6)
        weight = np.maximum(1 - (off / scale) ** 2, 0) ** 2
        slope = float((weight * x * y).sum() / max((weight * x * x).sum(), 1e-12))
    return slope


MAX_RANGE_M = 80.0
"""KITTI's sweeps hold no return from further away."""
FITS_RAD = np.radians(0.3)
"""A point further than this from its ring's line belongs to no beam."""
LEAST_RING_POINTS = 20
"""Points that tell a ring's line."""
MEET_M = 0.01
"""Beams with heights below this are taken to meet in the sensor's origin."""
ALIGNED = 0.5
"""Mean resultant of a ring's azimuths modulo a column, above which its columns are taken to lie evenly."""


@dataclass(frozen=True)
class KittiBeams:
    """Beams (B,), the highest first: ``elevation_rad``, ``height_m`` over the sensor's origin, ``azimuth_offset_rad``.
    ``columns``: of a whole turn. ``stated``: the drive says so, and they are told by their elevations, not by laps."""

    elevation_rad: FloatArray
    height_m: FloatArray
    azimuth_offset_rad: FloatArray
    columns: int
    stated: bool = False

    def model(self, direction: int, sweep_s: float) -> LidarModel:
        """Return the beam table of a sensor that turns in ``direction`` and looks forward at a frame's time."""
        return LidarModel(
            elevation_rad=self.elevation_rad,
            azimuth_offset_rad=self.azimuth_offset_rad,
            columns=self.columns,
            sweep_s=sweep_s,
            start_azimuth_rad=float(np.pi),
            direction=direction,
            time_offset_s=sweep_s / 2,
            max_range_m=MAX_RANGE_M,
        )


def count_laps(points: FloatArray) -> NDArray[np.int64]:
    """Return which lap of azimuth, from 0 forward and counter-clockwise, each point (N, 3+) in the file's order lies on: (N,)."""
    azimuth = np.arctan2(points[:, 1], points[:, 0]) % (2 * np.pi)
    step = np.diff(azimuth, prepend=azimuth[:1])
    return np.asarray(np.cumsum((step < -np.pi).astype(np.int64) - (step > np.pi)))


def find_beams(sweeps: Sequence[FloatArray]) -> KittiBeams | None:
    """Return the beams that some sweeps (N, 4) of a drive show; None where there are no rings in them."""
    laps = [count_laps(points) for points in sweeps]
    counts = Counter(int(lap.max()) + 1 for lap in laps if len(lap))
    if not counts:
        return None
    count = max(counts, key=lambda n: (counts[n], n))
    chosen = [(points, lap) for points, lap in zip(sweeps, laps, strict=True) if len(lap) and lap.max() + 1 == count]
    lines, rings = [], []
    for beam in range(count):
        points = np.concatenate([points[lap == beam] for points, lap in chosen])
        if len(points) < LEAST_RING_POINTS:
            continue
        lines.append(_line(np.hypot(points[:, 0], points[:, 1]), points[:, 2]))
        rings.append([points[lap == beam] for points, lap in chosen])
    if len(lines) < 2:
        return None
    slope, height = np.array(lines).T
    order = np.argsort(-slope, kind="stable")
    step = _azimuth_step([ring for parts in rings for ring in parts])
    if step is None:
        return None
    columns = int(round(2 * np.pi / step))
    if np.abs(height).max() < MEET_M:
        height = np.zeros_like(height)
    offsets = np.array([_offset(np.concatenate(parts), columns) for parts in rings])
    return KittiBeams(np.arctan(slope[order]), height[order], offsets[order], columns)


def assign_rings(points: FloatArray, beams: KittiBeams) -> NDArray[np.int32]:
    """Return the beam (N,) of each point (N, 3+) in the file's order, -1 where none fits.

    A sweep with as many laps as beams has one for each; in another each lap is the beam's whose line is nearest.
    """
    if beams.stated:
        elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
        rising = beams.elevation_rad[::-1]
        nearest = len(rising) - 1 - np.searchsorted((rising[1:] + rising[:-1]) / 2, elevation)
        return np.where(np.abs(beams.elevation_rad[nearest] - elevation) <= FITS_RAD, nearest, -1).astype(np.int32)
    lap = count_laps(points)
    laps = int(lap.max(initial=-1)) + 1
    distance = np.hypot(points[:, 0], points[:, 1])
    slope = np.tan(beams.elevation_rad)
    if laps == len(slope):
        ring = lap
    else:
        ring = np.zeros(len(points), np.int64)
        begins = np.flatnonzero(np.diff(lap, prepend=-1))
        for part in np.split(np.arange(len(points)), begins[1:]) if laps else ():
            off = points[part, None, 2] - beams.height_m - distance[part, None] * slope
            ring[part] = np.median(np.abs(off / distance[part, None]), 0).argmin()
    off = points[:, 2] - beams.height_m[ring] - distance * slope[ring]
    # across the beam, not along z
    fits = np.abs(off) * np.cos(beams.elevation_rad[ring]) ** 2 <= FITS_RAD * distance
    return np.where(fits, ring, -1).astype(np.int32)


def assign_columns(points: FloatArray, ring: NDArray[np.int32], model: LidarModel) -> NDArray[np.int32]:
    """Return the column (N,) of each point, -1 where its ring is."""
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    turn = model.direction * (azimuth - model.start_azimuth_rad - model.azimuth_offset_rad[ring]) / (2 * np.pi)
    column = np.floor(turn * model.columns).astype(np.int64) % model.columns
    return np.where(ring >= 0, column, -1).astype(np.int32)


def _line(distance: FloatArray, z: FloatArray) -> tuple[float, float]:
    """Slope and height of the line that most points lie on, by least squares of angles, outliers left out.

    A ring whose points are all at one distance tells no height: then it is 0.
    """
    weight = 1 / np.maximum(distance, 1.0)
    inliers = np.ones(len(z), bool)
    slope, height = 0.0, 0.0
    for _ in range(6):
        d, w = distance[inliers], weight[inliers]
        if np.ptp(d) < 0.05 * float(np.median(d)):
            return float(np.median(z[inliers] / d)), 0.0
        height, slope = np.linalg.lstsq(np.stack([w, d * w], 1), z[inliers] * w, rcond=None)[0].tolist()
        off = np.abs(z - height - slope * distance) * weight
        inliers = off <= max(4 * 1.4826 * float(np.median(off)), 1e-6)
    return slope, height


def _azimuth_step(rings: Sequence[FloatArray]) -> float | None:
    steps = []
    for points in rings:
        step = np.diff(np.arctan2(points[:, 1], points[:, 0]))
        steps.append(step[(step > 1e-4) & (step < np.radians(2.0))])
    every = np.concatenate(steps)
    return float(np.median(every)) if len(every) else None


def _offset(points: FloatArray, columns: int) -> float:
    """How far a ring's points lie, on average, from the middle of a column, radians; 0 where they lie anywhere in it."""
    step = 2 * np.pi / columns
    azimuth = np.arctan2(points[:, 1], points[:, 0])
    mean = np.exp(2j * np.pi * ((azimuth - np.pi) / step - 0.5)).mean()
    return float(np.angle(mean) / (2 * np.pi) * step) if abs(mean) > ALIGNED else 0.0
