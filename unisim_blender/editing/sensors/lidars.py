"""Recorded LiDAR returns of a frame, read from the log's files, and beam tables that people write."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...core.world.drive import LidarModel
from ..sampled.source import DriveSource


@dataclass(frozen=True)
class Recorded:
    """A LiDAR's recorded returns of a frame: points (N, 3) of the world, and attributes (N,) by name."""

    lidar: str
    points: FloatArray
    attributes: dict[str, NDArray[np.generic]]


def recorded_returns(source: DriveSource, frame: int) -> list[Recorded]:
    """Read the recorded returns of a frame, of every LiDAR, from the log's files; in any thread."""
    log, found = source.log, []
    for name in source.drive.lidars if log is not None else ():
        assert log is not None
        if frame not in log.sweep_frames(name):
            found.append(Recorded(name, np.zeros((0, 3)), {}))
            continue
        sweep = log.sweep(name, frame)
        depth = np.linalg.norm(sweep.points - sweep.origins, axis=1)
        attributes = {"intensity": sweep.intensity, "class": sweep.semantic, "depth": depth}
        found.append(Recorded(name, sweep.points, attributes))
    return found


def own_table(elevations: str, columns: int, max_range_m: float) -> LidarModel:
    """A LiDAR whose beams have these elevations, degrees separated by commas. Raises `UnisimError`."""
    try:
        degrees = np.array(sorted((float(part) for part in elevations.split(",") if part.strip()), reverse=True))
    except ValueError as fault:
        raise UnisimError(f'elevations "{elevations}": are not numbers separated by commas') from fault
    if not len(degrees) or not (np.abs(degrees) <= 90).all():
        raise UnisimError(f'elevations "{elevations}": must be at least one, between -90 and 90 degrees')
    return LidarModel(np.radians(degrees), np.zeros(len(degrees)), columns=columns, max_range_m=max_range_m)
