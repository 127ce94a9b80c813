"""Beam tables from files, as NCore writes LiDARs' parameters (github.com/NVIDIA/ncore, "row-offset spinning LiDAR")."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import UnisimError
from ..geometry import FloatArray
from ..json_file import Node, read_json
from ..world.drive import LidarModel

DIRECTIONS = {"cw": -1, "ccw": 1}
EVEN_RAD = 1e-5
"""Azimuths, which the files have in float32, that are no further from even ones are even."""


def read_beam_table(path: Path, min_range_m: float = 0.5, max_range_m: float = 200.0) -> LidarModel:
    """Return the beam table of a JSON file; a sweep ends at its frame's time.

    Members: ``row_elevations_rad``, ``row_azimuth_offsets_rad``, ``column_azimuths_rad`` as fired, ``spinning_frequency_hz``,
    ``spinning_direction`` ("cw" or "ccw"). Optional, beside NCore's own: ``row_times_s``, ``column_times_s``, how long after its
    column, and the frame's time, a beam and a column is fired. Columns over less than a turn (a solid-state LiDAR's) are fired
    evenly over the sweep. Ranges are the caller's, the files have none. Raises `UnisimError` naming file and value.
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
    if word not in DIRECTIONS:
        node.key("spinning_direction").fail(f'must be "cw" or "ccw", not "{word}"')
    if hertz <= 0:
        node.key("spinning_frequency_hz").fail(f"must be above 0, not {hertz:g}")
    direction, there = DIRECTIONS[word], node.object()
    step = direction * 2 * np.pi / len(azimuth)
    uneven = np.abs(np.unwrap(azimuth) - azimuth[0] - step * np.arange(len(azimuth))).max() > EVEN_RAD
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
