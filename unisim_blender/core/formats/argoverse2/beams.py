"""The beam table of a spinning LiDAR, found from its returns and their firing times.

The lasers are fired one after the other in a fixed cycle, while the device turns evenly. So a laser's elevation and its azimuth
beside the device's are medians over its returns, and a return's column is the number of its firing cycle. Turns and sweeps do
not keep step: in each sweep the columns are turned beside the table's by a phase of its own (`world.drive.SpinPhase`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...data.sweep_cells import BLOCKED_BELOW_RAD
from ...geometry import FloatArray
from ...sensors.lidar import beam_directions
from ...world.drive import LidarModel, SpinPhase

OPEN_SHARE = 1 / 3
"""Beams that return at an azimuth at some time, of all, where nothing stands in the way: road alone is seen by half of a
VLP-32C's beams. In a recorded drive the down LiDAR has 0 to 11 of 32 over 60 degrees, elsewhere both have 17 and more."""


def blocked_cells(seen: NDArray[np.bool_], model: LidarModel, up: FloatArray) -> NDArray[np.bool_]:
    """Return which cells (beams, columns) are blocked. ``seen`` (beams, columns): some of several sweeps returned there;
    ``up`` (3,): the vertical in the sensor's frame.

    They are never seen and look down steeply, or at an azimuth at which few beams see anything.
    """
    step = model.direction * 2 * np.pi / model.columns
    shifts = np.rint(model.azimuth_offset_rad / step).astype(np.int64)
    at_azimuth = (np.arange(model.columns)[None] - shifts[:, None]) % model.columns
    often = np.take_along_axis(seen, at_azimuth, 1).mean(0) >= OPEN_SHARE
    open_cells = often[(np.arange(model.columns)[None] + shifts[:, None]) % model.columns]
    looks_down = beam_directions(model) @ up < np.sin(BLOCKED_BELOW_RAD)
    return np.asarray(~seen & (looks_down | ~open_cells))


LEAST_M = 2.0
"""Nearer returns say little of a beam's direction."""
LEAST_RETURNS = 20
"""A laser with fewer returns than this is not in the table."""
MAX_COLUMNS = 20_000
MIN_RANGE_M, MAX_RANGE_M = 0.5, 225.0
TURN = 2 * np.pi


class UnknownBeamsError(ValueError):
    """Returns that tell no beam table."""


@dataclass(frozen=True)
class Firings:
    """Returns of one LiDAR in one sweep: laser (N,), time_s (N,) after the sweep's timestamp, and local (N, 3), in the sensor's
    frame at the time of firing."""

    laser: NDArray[np.int64]
    time_s: FloatArray
    local: FloatArray

    @property
    def elevation_rad(self) -> FloatArray:
        """Elevations (N,)."""
        return np.asarray(np.arctan2(self.local[:, 2], np.hypot(self.local[:, 0], self.local[:, 1])))

    @property
    def azimuth_rad(self) -> FloatArray:
        """Azimuths (N,), counter-clockwise from x."""
        return np.asarray(np.arctan2(self.local[:, 1], self.local[:, 0]))

    def chosen(self, which: NDArray[np.bool_] | slice) -> Firings:
        return Firings(self.laser[which], self.time_s[which], self.local[which])

    def far(self) -> Firings:
        """Return those far enough away to tell a direction."""
        return self.chosen(np.linalg.norm(self.local, axis=1) > LEAST_M)


@dataclass(frozen=True)
class BeamCells:
    """Where returns lie in the beam table: ring, column (N,), -1 where the laser is not in it; and how far the sweep's columns
    are turned beside the table's, radians."""

    ring: NDArray[np.int32]
    column: NDArray[np.int32]
    turned_rad: float


@dataclass(frozen=True)
class BeamTable:
    """A LiDAR's model with the number of each beam's laser (B,), the firing cycle (s) and how far the device turns in it
    (radians, negative clockwise). ``start_s``: when column 0 of a sweep begins, after the sweep's timestamp."""

    model: LidarModel
    laser: NDArray[np.int64]
    cycle_s: float
    step_rad: float
    start_s: float

    @property
    def rate(self) -> float:
        """How fast the device turns, rad/s."""
        return self.step_rad / self.cycle_s

    def place(self, firings: Firings) -> BeamCells:
        """Return the cells of a sweep's returns."""
        model = self.model
        assert model.beam_time_s is not None
        beam_of = np.full(int(max(self.laser.max(), firings.laser.max(initial=0))) + 1, -1)
        beam_of[self.laser] = np.arange(len(self.laser))
        ring = beam_of[firings.laser]
        known = ring >= 0
        if not known.any():
            nowhere = np.full(len(ring), -1, np.int32)
            return BeamCells(nowhere, nowhere, 0.0)
        cycles = (firings.time_s - model.beam_time_s[ring] - self.start_s) / self.cycle_s
        # cycles run on from sweep to sweep, which do not begin with one
        cycles -= _circular_mean(cycles[known] * TURN) / TURN
        column = np.rint(cycles).astype(np.int64)
        azimuth = firings.azimuth_rad - model.azimuth_offset_rad[ring] - self._even(column)
        far = known & (np.linalg.norm(firings.local, axis=1) > LEAST_M)
        turned = _circular_median(azimuth[far if far.any() else known])
        return BeamCells(
            np.where(known, ring, -1).astype(np.int32),
            np.where(known, column % model.columns, -1).astype(np.int32),
            turned,
        )

    def _even(self, column: NDArray[np.int64]) -> FloatArray:
        """The azimuths of columns, without offsets, at the device's own rate: the model's differ by a part of a column, as its
        columns are a whole turn."""
        middle = self.model.columns / 2 - 0.5
        step = self.model.direction * TURN / self.model.columns
        return self.model.start_azimuth_rad + step * (middle + 0.5) + self.step_rad * (column - middle)

    def phase(self, stamps_s: FloatArray, measured_s: FloatArray, turned_rad: FloatArray) -> SpinPhase:
        """Return the phase of sweeps stamped ``stamps_s`` (T,), from that of some of them: ``turned_rad`` (K,) at ``measured_s``.

        Between and beyond those the device is taken to turn evenly.
        """
        expected = np.unwrap(self.rate * (stamps_s - measured_s[0]))
        rest = np.unwrap(turned_rad - self.rate * (measured_s - measured_s[0]))
        turned = expected + np.interp(stamps_s, measured_s, rest)
        return SpinPhase(stamps_s, turned - TURN * np.rint(turned[0] / TURN))


def find_table(firings: Firings) -> BeamTable:
    """Return the table of the LiDAR that fired these. Raises `UnknownBeamsError`."""
    far = firings.far()
    far = far.chosen(np.isin(far.laser, _often(far.laser)))
    if not len(far.laser):
        raise UnknownBeamsError(f"its {len(firings.laser)} returns are too few to find its beams")
    order = np.lexsort((far.time_s, far.laser))
    far = Firings(far.laser[order], far.time_s[order], far.local[order])
    lasers, first, beam, count = np.unique(far.laser, return_index=True, return_inverse=True, return_counts=True)
    cycle = _cycle(far, beam)
    delays = np.array([_circular_mean(part * TURN) for part in np.split(far.time_s / cycle, first[1:])]) / TURN % 1
    # a cycle begins after the longest pause
    rising = np.sort(delays)
    pauses = np.diff(np.append(rising, rising[0] + 1))
    begin = rising[(int(pauses.argmax()) + 1) % len(rising)]
    delays = (delays - begin + 1e-6) % 1 - 1e-6
    start = begin * cycle + np.floor((far.time_s.min() - begin * cycle) / cycle + 1e-3) * cycle
    column = np.rint((far.time_s - start) / cycle - delays[beam]).astype(np.int64)
    step, base = _turning(far.azimuth_rad, column, beam, first, int(count.argmax()))
    columns = round(TURN / abs(step))
    if not 2 <= columns <= MAX_COLUMNS:
        raise UnknownBeamsError(f"its returns do not turn with time ({columns} columns)")
    elevation = np.array([np.median(part) for part in np.split(far.elevation_rad, first[1:])])
    offsets = base - base[0] - TURN * np.rint((base - base[0]) / TURN)
    azimuth = base[0] + float(offsets.mean())
    direction = 1 if step > 0 else -1
    middle = columns / 2 - 0.5
    start_azimuth = azimuth + step * middle - direction * TURN / columns * (middle + 0.5)
    down = np.argsort(-elevation, kind="stable")
    sweep_s = columns * cycle
    model = LidarModel(
        elevation_rad=elevation[down],
        azimuth_offset_rad=(offsets - offsets.mean())[down],
        columns=columns,
        sweep_s=sweep_s,
        start_azimuth_rad=float(start_azimuth),
        direction=direction,
        time_offset_s=float(start + sweep_s - cycle / 2),
        min_range_m=MIN_RANGE_M,
        max_range_m=MAX_RANGE_M,
        beam_time_s=np.maximum(delays[down], 0.0) * cycle,
    )
    return BeamTable(model, lasers[down].astype(np.int64), cycle, step, float(start))


def elevation_spread(firings: Firings) -> FloatArray:
    """Return by how much each laser's elevations spread, radians: the median distance from their median (B,)."""
    far = firings.far()
    elevation = far.elevation_rad
    parts = (elevation[far.laser == laser] for laser in _often(far.laser))
    return np.array([np.median(np.abs(part - np.median(part))) for part in parts])


def _often(laser: NDArray[np.int64]) -> NDArray[np.int64]:
    """The lasers with enough returns."""
    lasers, count = np.unique(laser, return_counts=True)
    return lasers[count >= LEAST_RETURNS]


def _cycle(far: Firings, beam: NDArray[np.int64]) -> float:
    """The firing cycle, seconds, of returns sorted by laser and time."""
    same = np.diff(beam) == 0
    gaps = np.diff(far.time_s)[same]
    gaps = gaps[gaps > 1e-7]
    if not len(gaps):
        raise UnknownBeamsError("its returns have one firing time each laser")
    cycle = float(np.median(gaps))
    for _ in range(2):  # the steps are counted with a first estimate, whose error the count does away with
        steps = np.where(same, np.rint(np.diff(far.time_s) / cycle), 0.0)
        count = np.append(0.0, np.cumsum(steps))
        middle_time, middle_count = (np.bincount(beam, values) / np.bincount(beam) for values in (far.time_s, count))
        time, count = far.time_s - middle_time[beam], count - middle_count[beam]
        if not (count**2).sum() > 0:
            raise UnknownBeamsError("its firing times have no cycle")
        cycle = float((time * count).sum() / (count**2).sum())
    if not cycle > 0:
        raise UnknownBeamsError("its firing times have no cycle")
    return cycle


def _turning(
    azimuth: FloatArray, column: NDArray[np.int64], beam: NDArray[np.int64], first: NDArray[np.int64], busiest: int
) -> tuple[float, FloatArray]:
    """How far the device turns from column to column, and each beam's azimuth in column 0 (B,). Returns are sorted by beam, and
    ``first`` (B,) is where each begins."""

    def bases() -> FloatArray:
        return np.array([_circular_median(part) for part in np.split(azimuth - step * column, first[1:])])

    of_beam = np.flatnonzero(beam == busiest)
    next_to = np.diff(column[of_beam]) == 1
    if not next_to.any():
        raise UnknownBeamsError("no two columns side by side have returns")
    turns = _wrapped(np.diff(azimuth[of_beam]))[next_to]
    step = float(np.median(turns))
    for _ in range(3):
        base = bases()
        rest = _wrapped(azimuth - step * column - base[beam])
        inliers = np.abs(rest) <= max(4 * float(np.median(np.abs(rest))), 1e-9)
        along = column[inliers] - column[inliers].mean()
        step += float((along * rest[inliers]).sum() / max((along**2).sum(), 1.0))
    return step, bases()


def _wrapped(angle: FloatArray) -> FloatArray:
    return np.asarray((angle + np.pi) % TURN - np.pi)


def _circular_mean(angle: FloatArray) -> float:
    return float(np.arctan2(np.sin(angle).mean(), np.cos(angle).mean()))


def _circular_median(angle: FloatArray) -> float:
    middle = _circular_mean(angle)
    return middle + float(np.median(_wrapped(angle - middle)))
