"""The beams of an HDL-64E, found in its sweeps: points come ring by ring, the upper one first, without ring or time.

Rings are told by wraps of azimuth. The beams do not meet in a point: beam k's points lie on the line ``z = height[k] + distance *
tan(elevation[k])``, distance from the sensor's axis. On recorded sweeps of 2011-09-26 a line leaves 0.002 to 0.006 degrees, where
elevations as seen from the sensor's origin differ by up to 4 degrees along a ring; heights are 0.116 to 0.209 m.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray
from ...world.drive import LidarModel

MAX_RANGE_M = 80.0
"""KITTI's sweeps hold no return from further away."""
FITS_RAD = np.radians(0.3)
"""A point further than this from its ring's line belongs to no beam."""
FEWEST = 20
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
        if len(points) < FEWEST:
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
    kept = np.ones(len(z), bool)
    slope, height = 0.0, 0.0
    for _ in range(6):
        d, w = distance[kept], weight[kept]
        if np.ptp(d) < 0.05 * float(np.median(d)):
            return float(np.median(z[kept] / d)), 0.0
        height, slope = np.linalg.lstsq(np.stack([w, d * w], 1), z[kept] * w, rcond=None)[0].tolist()
        off = np.abs(z - height - slope * distance) * weight
        kept = off <= max(4 * 1.4826 * float(np.median(off)), 1e-6)
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
