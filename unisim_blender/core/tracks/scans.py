"""Sweeps of all LiDARs in order of time, as the stages read them: returns in the world at their own times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..data.log import Log
from ..geometry import FloatArray

NEAR_M, FAR_M = 2.5, 75.0
"""Returns nearer show the vehicle itself, those further away are too few to tell what they are."""


@dataclass(frozen=True)
class ScanRef:
    """A sweep: its LiDAR, its frame, and the LiDAR's time of that frame, seconds."""

    lidar: str
    frame: int
    time_s: float


@dataclass(frozen=True)
class Scan:
    """Strongest returns of a sweep: points (N, 3) and their rays' origins (N, 3) in the world, metres, times (N,),
    seconds. A sweep's returns lie where they were at their own times, so that what stands is not distorted."""

    points: FloatArray
    origins: FloatArray
    time_s: FloatArray

    def some(self, rows: NDArray[np.int64]) -> Scan:
        """Return some of the returns."""
        return Scan(self.points[rows], self.origins[rows], self.time_s[rows])

    @property
    def nbytes(self) -> int:
        """The memory that they take."""
        return self.points.nbytes + self.origins.nbytes + self.time_s.nbytes


def scans_of(log: Log) -> tuple[ScanRef, ...]:
    """Return the sweeps of all LiDARs of a log in order of time."""
    refs = [
        ScanRef(name, frame, float(lidar.time_s[frame]))
        for name, lidar in log.drive.lidars.items()
        for frame in log.sweep_frames(name)
    ]
    return tuple(sorted(refs, key=lambda ref: (ref.time_s, ref.lidar)))


def read_scan(log: Log, ref: ScanRef) -> Scan:
    """Return a sweep's strongest returns from `NEAR_M` to `FAR_M`. Raises what the reader raises."""
    sweep = log.sweep(ref.lidar, ref.frame)
    range_m = np.linalg.norm(sweep.points - sweep.origins, axis=1)
    keep = np.isfinite(sweep.points).all(1) & (range_m > NEAR_M) & (range_m < FAR_M)
    if sweep.rank is not None:
        keep &= sweep.rank == 0
    return Scan(*(np.asarray(values[keep], np.float64) for values in (sweep.points, sweep.origins, sweep.time_s)))
