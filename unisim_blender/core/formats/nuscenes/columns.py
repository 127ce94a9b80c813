"""A sweep's file as columns of rings in firing order, its motion compensation undone.

All points are given in the sensor's frame at the end of the sweep. Every firing is in the file: one without a return lies at the
sensor's own place as it was fired, so these points tell where the sensor was in each column. On a recorded sweep 4393 of them lie
within 0.3 mm of one line, 0.45 m long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import LogError, in_a_line, refused
from ...geometry import BoolArray, FloatArray, Trajectory
from ...world.drive import LidarModel

NEAREST_M = 3.0
FEWEST = 20
"""Returns that tell a ring's angles."""
RINGS = 32
TABLE_DEG = 32.0 / 3 - np.arange(RINGS) * 4 / 3
"""The maker's elevations, the highest first: for a ring that never returns."""
MAX_RANGE_M = 100.0


def find_beams(sweeps: Sequence[tuple[SweepColumns, FloatArray]], columns: int, turn_s: float) -> LidarModel:
    """Return the beam table that sweeps show: their columns, and the points (32, C, 3) as `columns.undone` gives them."""
    starts: list[float] = []
    elevation: list[list[FloatArray]] = [[] for _ in range(RINGS)]
    offsets: list[list[FloatArray]] = [[] for _ in range(RINGS)]
    for sweep, local in sweeps:
        distance = np.linalg.norm(local, axis=-1)
        used = (distance > NEAREST_M) & ~sweep.dropped & ~sweep.own
        azimuth = np.arctan2(local[..., 1], local[..., 0])
        height = np.arctan2(local[..., 2], np.hypot(local[..., 0], local[..., 1]))
        turned = azimuth + 2 * np.pi * (np.arange(sweep.count) + 0.5) / columns  # clockwise
        if not used.any():
            continue
        start = _mean_angle(turned[used])
        starts.append(start)
        for ring in range(RINGS):
            elevation[ring].append(height[ring, used[ring]])
            offsets[ring].append(np.angle(np.exp(1j * (turned[ring, used[ring]] - start))))
    table = np.radians(TABLE_DEG)
    of_rings = [np.concatenate(parts) if parts else np.zeros(0) for parts in elevation]
    heights = np.array(
        [
            np.median(elevations) if len(elevations) >= FEWEST else table[ring]
            for ring, elevations in enumerate(of_rings)
        ]
    )
    beside = [np.concatenate(parts) if parts else np.zeros(0) for parts in offsets]
    return LidarModel(
        elevation_rad=heights,
        azimuth_offset_rad=np.array([float(np.median(part)) if len(part) >= FEWEST else 0.0 for part in beside]),
        columns=columns,
        sweep_s=turn_s,
        start_azimuth_rad=_mean_angle(np.array(starts)) if starts else np.pi / 2,
        direction=-1,
        time_offset_s=turn_s / (2 * columns),  # the last column is fired at the sweep's end
        max_range_m=MAX_RANGE_M,
    )


def column_azimuths(columns: SweepColumns, local: FloatArray, model: LidarModel) -> FloatArray:
    """Return the azimuths (C,) of a sweep's columns, without the beams' offsets, as its returns show them; the beam table's where
    nothing does.

    Turns and sweeps do not keep step, and a turn is no whole number of columns: a line is fitted.
    """
    count = columns.count
    table = model.start_azimuth_rad - 2 * np.pi * (np.arange(count) + 0.5) / model.columns
    used = (np.linalg.norm(local, axis=-1) > NEAREST_M) & ~columns.dropped & ~columns.own
    ring, column = np.nonzero(used)
    if not len(ring):
        return table
    azimuth = np.arctan2(local[ring, column, 1], local[ring, column, 0]) - model.azimuth_offset_rad[ring]
    turned = _mean_angle(azimuth - table[column])
    off = np.angle(np.exp(1j * (azimuth - table[column] - turned)))
    near = np.abs(off) < 2 * np.pi / model.columns * 3
    if not near.any() or np.ptp(column[near]) < count / 4:
        return np.asarray(table + turned)
    slope, level = np.polyfit(column[near], off[near], 1)
    return np.asarray(table + turned + level + slope * np.arange(count))


def _mean_angle(angles: FloatArray) -> float:
    """The angle that most of some lie at."""
    mean = float(np.angle(np.exp(1j * angles).mean()))
    return mean + float(np.median(np.angle(np.exp(1j * (angles - mean)))))


ROW_BYTES = 20
MAX_BYTES = 64 * 2**20
OWN_FROM_DATASETS = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
"""The dataset's LiDAR axes (x right, y forward) in ours (x forward, y left)."""
MOST_OFF_M = 0.02
"""A point further from where the sensor was is no firing without a return."""
FARTHEST_M = 1e4
BODY_MIN_M, BODY_MAX_M = np.array([-1.3, -0.85, -1.2]), np.array([2.0, 0.85, -0.1])
"""Box in the LiDAR's frame in which a return comes from the vehicle's own roof."""


@dataclass(frozen=True)
class SweepColumns:
    """A sweep of C columns and R rings (the dataset's own LiDAR has 32), the highest ring first, in the LiDAR's frame at the
    sweep's end, our axes.

    points (R, C, 3); origins (C, 3): where the sensor was; intensity (R, C) as in the file; dropped (R, C): no return; own
    (R, C): a return from the vehicle itself.
    """

    points: FloatArray
    origins: FloatArray
    intensity: NDArray[np.float32]
    dropped: BoolArray
    own: BoolArray

    @property
    def count(self) -> int:
        return len(self.origins)


def count_columns(path: Path, rings: int = RINGS) -> int:
    """Return the number of columns in a file, by its size. Raises `LogError`."""
    with refused(path, "read", LogError):
        size = path.stat().st_size
    if not size or size % (ROW_BYTES * rings):
        raise LogError(f"{path}: is cut off, its {size} bytes are no whole number of columns of {rings} points")
    if size > MAX_BYTES:
        raise LogError(f"{path}: refused, it has more than {MAX_BYTES // 2**20} MiB")
    return size // (ROW_BYTES * rings)


def column_times(count: int, end_s: float, turn_s: float) -> FloatArray:
    """Return when each of a sweep's columns (C,) was fired; the last at the sweep's end."""
    return np.asarray(end_s - turn_s * (count - 1 - np.arange(count)) / count)


def read_columns(path: Path, expected: FloatArray | None = None, rings: int = RINGS) -> SweepColumns:
    """Return a sweep's columns.

    ``expected`` (C, 3): about where the sensor was, as the vehicle's poses say; it was there where all firings returned.
    Raises `LogError`.
    """
    count = count_columns(path, rings)
    try:
        table = np.fromfile(path, "<f4").reshape(count, rings, 5)
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read ({in_a_line(error)})") from error
    if not np.array_equal(table[..., 4], np.broadcast_to(np.arange(rings, dtype="<f4"), (count, rings))):
        raise LogError(f"{path}: its points are no columns of rings 0 to {rings - 1}")
    bad = ~(np.abs(table[..., :3]).max(-1) < FARTHEST_M)  # nan is none, either
    if bad.any() or not np.isfinite(table[..., 3]).all():
        raise LogError(f"{path}: holds a point that is not finite or beyond {FARTHEST_M:.0f} m")
    points = table[:, ::-1, :3].astype(np.float64) @ OWN_FROM_DATASETS.T
    origins = np.zeros((count, 3)) if expected is None else expected
    origins, dropped = _origins(points, origins)
    offset = points - origins[:, None]
    own = ((offset > BODY_MIN_M) & (offset < BODY_MAX_M)).all(-1) & ~dropped
    intensity = table[:, ::-1, 3]
    return SweepColumns(points.transpose(1, 0, 2).copy(), origins, intensity.T.copy(), dropped.T.copy(), own.T.copy())


def _origins(points: FloatArray, expected: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Where the sensor was in each column (C, 3), and which points (C, R) lie there.

    Several points of a column at the very same place are firings without a return: two returns never are. Between such columns
    the sensor's way is a parabola, as it is in a twentieth of a second.
    """
    count = len(points)
    same = (points[:, :, None] == points[:, None, :]).all(-1).sum(-1) > 1  # (C, R): another of the column is there, too
    near = np.linalg.norm(points - expected[:, None], axis=-1) < 2.0
    column, ring = np.nonzero(same & near)
    if len(np.unique(column)) < 3:
        dropped = np.linalg.norm(points - expected[:, None], axis=-1) < MOST_OFF_M
        return expected, dropped
    share = (np.arange(count) + 1) / count
    fitted = np.stack([_parabola(share[column], points[column, ring, axis], share) for axis in range(3)], -1)
    dropped = np.linalg.norm(points - fitted[:, None], axis=-1) < MOST_OFF_M
    origins = fitted.copy()
    there = dropped.sum(1)
    exact = there > 0
    origins[exact] = (np.where(dropped[..., None], points, 0).sum(1))[exact] / there[exact, None]
    return origins, dropped


def _parabola(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """A parabola through most of points x, y (N,), evaluated at (M,)."""
    inliers = np.ones(len(x), bool)
    degree = 2 if np.ptp(x) > 0.3 else 1
    values = np.zeros(len(at))
    for _ in range(4):
        fit = np.polyfit(x[inliers], y[inliers], degree)
        off = np.abs(y - np.polyval(fit, x))
        values = np.polyval(fit, at)
        inliers = off <= max(5 * float(np.median(off[inliers])), 1e-4)
    return np.asarray(values)


def undone(columns: SweepColumns, time_s: FloatArray, end_s: float, track: Trajectory) -> FloatArray:
    """Return the points (R, C, 3) in the sensor's frame at each column's own time (C,); ``track`` gives its world poses."""
    end, then = track.at(end_s)[:3, :3], track.at(time_s)[:, :3, :3]
    then_from_end = then.transpose(0, 2, 1) @ end
    return np.asarray(np.einsum("cij,rcj->rci", then_from_end, columns.points - columns.origins))
