"""Road cells, seen from above, of a log whose sweeps have semantic classes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from .log import Log, extras_of

CELL_M = 0.25
EVERY_M = 1.0
"""Distance, metres, that the vehicle moves from one sweep that is read to the next."""
_ROW = np.int64(1) << 32
_AROUND = np.array([x * _ROW + y for x in (-1, 0, 1) for y in (-1, 0, 1)])


@dataclass(frozen=True, eq=False)
class RoadCells:
    """Cells of `CELL_M`, world frame, by their numbers in order: ``road`` has those with a return of road, ``other``
    those with returns of what is no road alone."""

    road: NDArray[np.int64]
    other: NDArray[np.int64]

    def look_up(self, points: FloatArray) -> tuple[BoolArray, BoolArray]:
        """Return which points (N, 2), world frame, are on the road, and for which this is known: (N,) bool each. A cell
        without returns is like the eight around it: road where one of them is, unknown where none has returns."""
        cells = _numbers(points)
        on, off = np.isin(cells, self.road), np.isin(cells, self.other)
        around = cells[:, None] + _AROUND
        near_road, near_other = (np.isin(around, some).any(1) for some in (self.road, self.other))
        is_road = on | (near_road & ~off)
        return is_road, is_road | off | near_other


def road_cells(log: Log) -> RoadCells | None:
    """Return the road of a log, by `LogExtras.road`; None where no sweep tells of it. Raises `LogError`."""
    is_road = extras_of(log).road
    classes = [np.array([number for number, road in is_road.items() if road is wanted]) for wanted in (True, False)]
    by_kind: list[list[NDArray[np.int64]]] = [[], []]
    scanning = [name for name, sensor in log.drive.lidars.items() if sensor.model.beams]
    for lidar in scanning if is_road else ():
        for frame in _spread(log, lidar):
            sweep = log.sweep(lidar, frame)
            for numbers, cells in zip(classes, by_kind, strict=True):
                cells.append(np.unique(_numbers(sweep.points[np.isin(sweep.semantic, numbers), :2])))
    road, other = (np.unique(np.concatenate([np.zeros(0, np.int64), *cells])) for cells in by_kind)
    return RoadCells(road, np.setdiff1d(other, road)) if len(road) else None


def _spread(log: Log, lidar: str) -> list[int]:
    """Return the frames of a LiDAR's sweeps, one for each `EVERY_M` that the vehicle goes."""
    frames, drive = log.sweep_frames(lidar), log.drive
    if not frames:
        return []
    times = drive.lidars[lidar].time_s
    places = drive.world_from_ego.positions_at(np.array([times[frame] for frame in frames]))[:, :2]
    gone = np.cumsum(np.hypot(*np.diff(places, axis=0, prepend=places[:1]).T))
    return [frames[index] for index in np.unique(np.floor(gone / EVERY_M), return_index=True)[1]]


def _numbers(points: FloatArray) -> NDArray[np.int64]:
    """Return the numbers of the cells that points (N, 2) are in."""
    x, y = np.floor(points / CELL_M).astype(np.int64).T
    return x * _ROW + y
