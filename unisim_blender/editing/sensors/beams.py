"""Beam tables that people write."""

from __future__ import annotations

import numpy as np

from ...core.errors import UnisimError
from ...core.world.drive import LidarModel


def own_table(elevations: str, columns: int, max_range_m: float) -> LidarModel:
    """A LiDAR whose beams have these elevations, degrees separated by commas. Raises `UnisimError`."""
    try:
        degrees = np.array(sorted((float(part) for part in elevations.split(",") if part.strip()), reverse=True))
    except ValueError as fault:
        raise UnisimError(f'elevations "{elevations}": are not numbers separated by commas') from fault
    if not len(degrees) or not (np.abs(degrees) <= 90).all():
        raise UnisimError(f'elevations "{elevations}": must be at least one, between -90 and 90 degrees')
    return LidarModel(np.radians(degrees), np.zeros(len(degrees)), columns=columns, max_range_m=max_range_m)
