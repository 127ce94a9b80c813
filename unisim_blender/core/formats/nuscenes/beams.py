"""The beam table of nuScenes' HDL-32E, measured in a scene's sweeps."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...geometry import FloatArray
from ...world.drive import LidarModel
from .columns import RINGS, SweepColumns

NEAREST_M = 3.0
FEWEST = 20
"""Returns that tell a ring's angles."""
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
    found = [np.concatenate(parts) if parts else np.zeros(0) for parts in elevation]
    heights = np.array([np.median(one) if len(one) >= FEWEST else table[ring] for ring, one in enumerate(found)])
    beside = [np.concatenate(parts) if parts else np.zeros(0) for parts in offsets]
    return LidarModel(
        elevation_rad=heights,
        azimuth_offset_rad=np.array([float(np.median(one)) if len(one) >= FEWEST else 0.0 for one in beside]),
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
