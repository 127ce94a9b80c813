"""NCore's "row-offset spinning" LiDAR parameters and our beam tables. NCore's angles are float32: 4e-7 rad."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import LogError, OutputError, in_a_line
from ...json_file import Node
from ...sensors.beam_table_file import DIRECTIONS, beam_table
from ...sensors.lidar import column_azimuths
from ...world.drive import LidarModel


def parameters_of(model: LidarModel, where: str) -> Any:
    """Return NCore's parameters of a beam table. Raises `OutputError` for a table that NCore cannot hold."""
    from ncore import data

    words: dict[int, Any] = {direction: word for word, direction in DIRECTIONS.items()}
    azimuth = (column_azimuths(model) + np.pi) % (2 * np.pi) - np.pi
    try:
        return data.RowOffsetStructuredSpinningLidarModelParameters(
            spinning_frequency_hz=1 / model.sweep_s,
            spinning_direction=words[model.direction],
            n_rows=model.beams,
            n_columns=model.columns,
            row_elevations_rad=model.elevation_rad.astype(np.float32),
            column_azimuths_rad=azimuth.astype(np.float32),
            row_azimuth_offsets_rad=model.azimuth_offset_rad.astype(np.float32),
        )
    except (AssertionError, ZeroDivisionError) as fault:
        raise OutputError(f"{where}: NCore cannot hold its beam table: {in_a_line(fault)}") from fault


def model_of(parameters: Any, where: str) -> LidarModel:
    """Return the beam table of NCore's parameters. Raises `LogError`."""
    kind = parameters.type()
    if kind != "row-offset-spinning":
        raise LogError(f"{where}: has a beam table of the type {kind!r:.60}, which is not read")
    values = {
        name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(parameters).items()
    }
    return beam_table(Node(values, f"{where}: ", LogError))
