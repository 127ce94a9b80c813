"""Beam tables of LiDARs that are widely used, by name, in their makers' degrees."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..geometry import FloatArray
from ..world.drive import LidarModel

PANDAR64_ELEVATION_DEG = (
    *(
        14.882,
        11.032,
        8.059,
        5.057,
        3.04,
        2.028,
        1.86,
        1.688,
        1.522,
        1.351,
        1.184,
        1.013,
        0.846,
        0.675,
        0.508,
        0.337,
        0.169,
    ),
    *(
        0.0,
        -0.169,
        -0.337,
        -0.508,
        -0.675,
        -0.846,
        -1.013,
        -1.184,
        -1.351,
        -1.522,
        -1.688,
        -1.86,
        -2.028,
        -2.198,
        -2.365,
    ),
    *(-2.536, -2.7, -2.873, -3.04, -3.21, -3.375, -3.548, -3.712, -3.884, -4.05, -4.221, -4.385, -4.558, -4.72, -4.892),
    *(-5.057, -5.229, -5.391, -5.565, -5.726, -5.898, -6.061, -7.063, -8.059, -9.06, -9.885, -11.032, -12.006, -12.974),
    *(-13.93, -18.889, -24.897),
)


def _model(
    elevation_deg: FloatArray, columns: int, max_range_m: float, azimuth_offset_deg: FloatArray | None = None
) -> LidarModel:
    offset = np.zeros(len(elevation_deg)) if azimuth_offset_deg is None else azimuth_offset_deg
    return LidarModel(np.radians(elevation_deg), np.radians(offset), columns=columns, max_range_m=max_range_m)


def pandar64() -> LidarModel:
    """Hesai Pandar64: 64 beams, dense about the horizon, 0.2 degrees from column to column."""
    clockwise = np.full(64, -1.042)
    clockwise[6:54] = np.tile(
        [1.042, 3.125, 5.208, -5.208, -3.125, -1.042], 8
    )  # the six lasers of a block side by side
    return _model(np.array(PANDAR64_ELEVATION_DEG), 1800, 200.0, -clockwise)


def vlp16() -> LidarModel:
    """Velodyne VLP-16: 16 beams 2 degrees apart."""
    return _model(np.linspace(15.0, -15.0, 16), 1800, 100.0)


VLP32C = (
    *(
        (15.0, -1.4),
        (10.333, 1.4),
        (7.0, -1.4),
        (4.667, 1.4),
        (3.333, -1.4),
        (2.333, 1.4),
        (1.667, -4.2),
        (1.333, -1.4),
    ),
    *((1.0, 1.4), (0.667, 4.2), (0.333, -4.2), (0.0, -1.4), (-0.333, 1.4), (-0.667, 4.2), (-1.0, -4.2), (-1.333, -1.4)),
    *(
        (-1.667, 1.4),
        (-2.0, 4.2),
        (-2.333, -4.2),
        (-2.667, -1.4),
        (-3.0, 1.4),
        (-3.333, 4.2),
        (-3.667, -4.2),
        (-4.0, -1.4),
    ),
    *(
        (-4.667, 1.4),
        (-5.333, 4.2),
        (-6.148, -1.4),
        (-7.254, 1.4),
        (-8.843, -1.4),
        (-11.31, 1.4),
        (-15.639, -1.4),
        (-25.0, 1.4),
    ),
)
"""Elevation and azimuth offset, clockwise, of each laser."""


def vlp32c() -> LidarModel:
    """Velodyne VLP-32C (Ultra Puck): 32 beams, dense about the horizon."""
    elevation, clockwise = np.array(VLP32C).T
    return _model(elevation, 1800, 200.0, -clockwise)


def hdl64e() -> LidarModel:
    """Velodyne HDL-64E: 32 beams a third of a degree apart from 2 degrees down, then 32 half a degree apart."""
    return _model(np.concatenate([2.0 - np.arange(32) / 3, -8.0 - 5 / 6 - np.arange(32) / 2]), 1800, 120.0)


def hdl32e() -> LidarModel:
    """Velodyne HDL-32E: 32 beams 4/3 degrees apart."""
    return _model(np.linspace(32.0 / 3, -92.0 / 3, 32), 1800, 100.0)


def os1_64() -> LidarModel:
    """Ouster OS1-64: 64 even beams over 45 degrees, 1024 columns."""
    return _model(np.linspace(22.5, -22.5, 64), 1024, 120.0)


def os1_128() -> LidarModel:
    """Ouster OS1-128: 128 even beams over 45 degrees, 1024 columns."""
    return _model(np.linspace(22.5, -22.5, 128), 1024, 120.0)


BEAM_TABLES: dict[str, Callable[[], LidarModel]] = {
    "pandar64": pandar64,
    "vlp16": vlp16,
    "vlp32c": vlp32c,
    "hdl32e": hdl32e,
    "hdl64e": hdl64e,
    "os1-64": os1_64,
    "os1-128": os1_128,
}
