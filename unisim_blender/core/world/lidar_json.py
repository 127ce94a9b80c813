"""Beam tables as JSON: members that a table lacks are left out."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..json_file import Node
from .drive import LidarModel, SpinPhase

NUMBERS = ("sweep_s", "start_azimuth_rad", "time_offset_s", "min_range_m", "max_range_m")
TABLES = ("column_azimuth_rad", "column_time_s", "beam_time_s")
"""Those that a table of even columns lacks."""


def lidar_model_to_json(model: LidarModel) -> dict[str, Any]:
    """Return a beam table's members, in a fixed order."""
    return {
        name: value.tolist() if isinstance(value, np.ndarray) else value
        for name, value in vars(model).items()
        if value is not None
    }


def read_lidar_model(node: Node) -> LidarModel:
    """Return the beam table of a JSON object. Raises the node's error."""
    elevation = node.key("elevation_rad").array(-1)
    offset = node.key("azimuth_offset_rad").array(-1)
    if len(offset) != len(elevation):
        node.key("azimuth_offset_rad").fail(f"has {len(offset)} beams, elevation_rad has {len(elevation)}")
    columns, direction = node.key("columns").integer(at_least=1), node.key("direction").integer()
    if direction not in (-1, 1):
        node.key("direction").fail(f"must be -1 or 1, not {direction}")
    there = [name for name in TABLES if name in node.object()]
    counts = dict(zip(TABLES, (columns, columns, len(elevation)), strict=True))
    tables: dict[str, Any] = {name: node.key(name).array(counts[name]) for name in there}
    numbers: dict[str, Any] = {name: node.key(name).number() for name in NUMBERS}
    try:
        return LidarModel(elevation, offset, columns=columns, direction=direction, **numbers, **tables)
    except ValueError as fault:
        node.fail(str(fault))


def phase_to_json(phase: SpinPhase) -> dict[str, Any]:
    """Return a phase's members."""
    return {"times_s": phase.times_s.tolist(), "turned_rad": phase.turned_rad.tolist()}


def read_phase(node: Node) -> SpinPhase:
    """Return the phase of a JSON object. Raises the node's error."""
    times = node.key("times_s").array(-1)
    turned = node.key("turned_rad").array(len(times))
    if not len(times) or (np.diff(times) <= 0).any():
        node.key("times_s").fail("must be times that increase")
    return SpinPhase(times, turned)
