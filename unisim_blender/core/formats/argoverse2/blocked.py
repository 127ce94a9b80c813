"""Which cells of a LiDAR the vehicle itself blocks. What its own body returned is not in the log: these cells are empty."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...data.sweep_cells import BLOCKED_BELOW_RAD
from ...geometry import FloatArray
from ...sensors.lidar import beam_directions
from ...world.drive import LidarModel

OPEN_SHARE = 1 / 3
"""Beams that return at an azimuth at some time, of all, where nothing stands in the way: road alone is seen by half of a
VLP-32C's beams. In a recorded drive the down LiDAR has 0 to 11 of 32 over 60 degrees, elsewhere both have 17 and more."""


def blocked_cells(seen: NDArray[np.bool_], model: LidarModel, up: FloatArray) -> NDArray[np.bool_]:
    """Return which cells (beams, columns) are blocked. ``seen`` (beams, columns): some of several sweeps returned there;
    ``up`` (3,): the vertical in the sensor's frame.

    They are never seen and look down steeply, or at an azimuth at which few beams see anything.
    """
    step = model.direction * 2 * np.pi / model.columns
    shifts = np.rint(model.azimuth_offset_rad / step).astype(np.int64)
    at_azimuth = (np.arange(model.columns)[None] - shifts[:, None]) % model.columns
    often = np.take_along_axis(seen, at_azimuth, 1).mean(0) >= OPEN_SHARE
    open_cells = often[(np.arange(model.columns)[None] + shifts[:, None]) % model.columns]
    looks_down = beam_directions(model) @ up < np.sin(BLOCKED_BELOW_RAD)
    return np.asarray(~seen & (looks_down | ~open_cells))
