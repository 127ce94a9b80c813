"""Sweeps of all LiDARs in order of time, as the stages read them: returns in the world at their own times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..data.log import Log
from ..geometry import FloatArray

NEAR_M, FAR_M = 2.5, 75.0
"""Returns nearer show the vehicle itself, those further away are too few to tell what they are."""
STORED_BYTES = 1 << 30
"""Largest sum of sweeps in memory."""


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


class SweepStore:
    """Sweeps of a log in order of time, each sorted along x, in which places are looked up; as many stay in memory as fit."""

    def __init__(self, log: Log) -> None:
        self.log, self.refs = log, scans_of(log)
        self.times_s = np.array([ref.time_s for ref in self.refs])
        self._scans: dict[ScanRef, Scan] = {}
        self._bytes = 0

    def near(self, number: int, xy: FloatArray, reach_m: float) -> Scan:
        """Return the part of a sweep whose x and y are within a distance of a place (2,)."""
        scan = self._read(self.refs[number])
        low, high = np.searchsorted(scan.points[:, 0], (xy[0] - reach_m, xy[0] + reach_m))
        return scan.some(low + np.flatnonzero(np.abs(scan.points[low:high, 1] - xy[1]) < reach_m))

    def passing_s(self, number: int, xy: FloatArray) -> float:
        """Return about when a sweep's beams pass a place (2,)."""
        times = self.near(number, xy, 3.0).time_s
        return float(np.median(times)) if len(times) else float(self.times_s[number])

    def nearest(self, time_s: float) -> list[int]:
        """Return the number of the sweep of each LiDAR that is nearest to a time."""
        furthest_first = np.argsort(-np.abs(self.times_s - time_s), kind="stable").tolist()
        return list({self.refs[number].lidar: number for number in furthest_first}.values())

    def _read(self, ref: ScanRef) -> Scan:
        if ref not in self._scans:
            scan = read_scan(self.log, ref)
            self._scans[ref] = scan.some(np.argsort(scan.points[:, 0], kind="stable"))
            self._bytes += scan.nbytes
            while self._bytes > STORED_BYTES and len(self._scans) > 1:
                self._bytes -= self._scans.pop(next(iter(self._scans))).nbytes
        return self._scans[ref]
