"""A sweep as nuScenes has it: every firing, column by column, in the sensor's frame at the sweep's end.

A firing without a return lies where the sensor was. One that the vehicle itself blocks is a return from its roof.
"""

from __future__ import annotations

import numpy as np

from ...data.log import SweepGrid
from ...geometry import FloatArray
from ...sensors.lidar import beam_directions, column_times
from ...world.captures import SECOND_US, microseconds
from ...world.drive import Lidar, LidarModel
from .columns import BODY_MAX_M, BODY_MIN_M, OWN_FROM_DATASETS

EPOCH_US = 1_500_000_000 * SECOND_US
"""The dataset's time, microseconds, of a drive's 0 s."""
ROOF_M = 0.8
"""How far away the vehicle's roof is where it blocks a beam: nearer than the 1 m within which the dataset's tools leave out
points."""


def stamp_us(time_s: float) -> int:
    """Return a time of the drive as the dataset's stamp."""
    return microseconds(time_s) + EPOCH_US


def seconds(stamp: int) -> float:
    """Return the drive's time of a stamp."""
    return (stamp - EPOCH_US) / SECOND_US


def sweep_stamp(lidar: Lidar, frame: int) -> int:
    """Return the stamp of a frame's sweep: when its last column is fired."""
    return stamp_us(float(column_times(lidar, lidar.time_s[frame])[-1]))


def last_column_s(model: LidarModel) -> float:
    """Return how long after a frame's time the last column is fired."""
    end = -model.sweep_s * 0.5 / model.columns if model.column_time_s is None else float(model.column_time_s[-1])
    return model.time_offset_s + end


def sweep_file(grid: SweepGrid, lidar: Lidar, frame: int, end_s: float) -> bytes:
    """Return the file's bytes: x, y, z, intensity 0..255 and ring, float32, of beams x columns."""
    fired = column_times(lidar, lidar.time_s[frame])
    poses, end = lidar.world_from_lidar.at(fired), lidar.world_from_lidar.at(end_s)
    origins = poses[:, :3, 3]
    world = np.broadcast_to(origins, grid.directions.shape).copy()
    there = grid.returned
    world[there] = grid.origins[there] + grid.directions[there] * grid.depth_m[there, None].astype(np.float64)
    roof = grid.blocked & _hits_roof(lidar, frame)
    world[roof] = grid.origins[roof] + grid.directions[roof] * ROOF_M
    local = (world - end[:3, 3]) @ end[:3, :3] @ OWN_FROM_DATASETS
    beams, columns = there.shape
    table = np.zeros((columns, beams, 5), "<f4")
    # the dataset's ring 0 is the lowest
    table[..., :3] = local[::-1].transpose(1, 0, 2)
    table[..., 3] = 255 * grid.intensity[::-1].T
    table[..., 4] = np.arange(beams)
    return table.tobytes()


def _hits_roof(lidar: Lidar, frame: int) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Which cells (beams, columns) pass, ROOF_M away, the box that the dataset's returns from the roof lie in."""
    local: FloatArray = beam_directions(lidar.model_at(lidar.time_s[frame])) * ROOF_M
    return np.asarray(((local > BODY_MIN_M) & (local < BODY_MAX_M)).all(-1))
