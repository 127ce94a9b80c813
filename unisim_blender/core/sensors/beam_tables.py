"""Beam tables of LiDARs that are widely used, by name, in their makers' degrees; and from files, as NCore writes
LiDARs' parameters (github.com/NVIDIA/ncore, "row-offset spinning LiDAR").
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import UnisimError
from ..geometry import FloatArray
from ..json_file import Node, read_json
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
"""Elevation and azimuth offset, clockwise, of each laser, degrees."""


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


ROTATION_SIGNS = {"cw": -1, "ccw": 1}
EVEN_TOLERANCE_RAD = 1e-5
"""Largest deviation, radians, of azimuths from even ones that counts as rounding: files have them in float32."""


def read_beam_table(path: Path, min_range_m: float = 0.5, max_range_m: float = 200.0) -> LidarModel:
    """Return the beam table of a JSON file; a sweep ends at its frame's time.

    Members: ``row_elevations_rad``, ``row_azimuth_offsets_rad``, ``column_azimuths_rad`` as fired,
    ``spinning_frequency_hz``, ``spinning_direction`` ("cw" or "ccw"). Optional, beside NCore's own: ``row_times_s``,
    ``column_times_s``, how long after its column, and the frame's time, a beam and a column is fired. Columns over less
    than a turn (a solid-state LiDAR's) are fired evenly over the sweep. Ranges are the caller's, the files have none.
    Raises `UnisimError` naming file and value.
    """
    return beam_table(Node(read_json(path, UnisimError), f"{path}: ", UnisimError), min_range_m, max_range_m)


def beam_table(node: Node, min_range_m: float = 0.5, max_range_m: float = 200.0) -> LidarModel:
    """Return the beam table of the members that `read_beam_table` lists. Raises the node's error."""
    elevation = node.key("row_elevations_rad").array(-1)
    if not len(elevation):
        node.key("row_elevations_rad").fail("is empty")
    offset = node.key("row_azimuth_offsets_rad").array(len(elevation))
    azimuth = node.key("column_azimuths_rad").array(-1)
    if not len(azimuth):
        node.key("column_azimuths_rad").fail("is empty")
    for name, count in (("n_rows", len(elevation)), ("n_columns", len(azimuth))):
        if name in node.object() and node.key(name).integer() != count:
            node.key(name).fail(f"is not {count}, of which there are azimuths or elevations")
    word, hertz = node.key("spinning_direction").text(), node.key("spinning_frequency_hz").number()
    if word not in ROTATION_SIGNS:
        node.key("spinning_direction").fail(f'must be "cw" or "ccw", not "{word}"')
    if hertz <= 0:
        node.key("spinning_frequency_hz").fail(f"must be above 0, not {hertz:g}")
    direction, there = ROTATION_SIGNS[word], node.object()
    step = direction * 2 * np.pi / len(azimuth)
    uneven = np.abs(np.unwrap(azimuth) - azimuth[0] - step * np.arange(len(azimuth))).max() > EVEN_TOLERANCE_RAD
    order = np.argsort(-elevation, kind="stable")
    try:
        return LidarModel(
            elevation_rad=elevation[order],
            azimuth_offset_rad=offset[order],
            columns=len(azimuth),
            sweep_s=1 / hertz,
            start_azimuth_rad=float(azimuth[0] - step / 2),
            direction=direction,
            min_range_m=min_range_m,
            max_range_m=max_range_m,
            column_azimuth_rad=azimuth if uneven else None,
            column_time_s=_optional(node, there, "column_times_s", len(azimuth)),
            beam_time_s=_ordered(_optional(node, there, "row_times_s", len(elevation)), order),
        )
    except ValueError as fault:
        node.key("column_azimuths_rad").fail(f"cannot be used: {fault}")


def _optional(node: Node, there: dict[str, object], name: str, count: int) -> FloatArray | None:
    return node.key(name).array(count) if name in there else None


def _ordered(values: FloatArray | None, order: NDArray[np.int64]) -> FloatArray | None:
    return None if values is None else values[order]
