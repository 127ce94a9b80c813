"""LiDAR rays: every cell of beams x columns, at its own time, from where the sensor was then."""

from __future__ import annotations

import numpy as np

from ..geometry import FloatArray
from ..world.drive import Lidar, LidarModel
from .rays import Rays


def beam_directions(model: LidarModel) -> FloatArray:
    """Unit directions (beams, columns, 3) in the sensor's frame."""
    turn = model.direction * 2 * np.pi * (np.arange(model.columns) + 0.5) / model.columns
    azimuth = model.start_azimuth_rad + turn[None, :] + model.azimuth_offset_rad[:, None]
    elevation = np.broadcast_to(model.elevation_rad[:, None], azimuth.shape)
    cosine = np.cos(elevation)
    return np.stack([cosine * np.cos(azimuth), cosine * np.sin(azimuth), np.sin(elevation)], -1)


def column_times(lidar: Lidar, time_s: float) -> FloatArray:
    """When each column of the sweep at ``time_s`` is fired (columns,)."""
    model = lidar.model
    fraction = (np.arange(model.columns) + 0.5) / model.columns
    return time_s + model.time_offset_s + model.sweep_s * (fraction - 1)


def lidar_rays(lidar: Lidar, time_s: float) -> Rays:
    """Rays (beams, columns) of the sweep at ``time_s``, in the world frame."""
    local = beam_directions(lidar.model)
    time = column_times(lidar, time_s)
    poses = lidar.world_from_lidar.at(time)
    directions = np.einsum("cij,bcj->bci", poses[:, :3, :3], local)
    origins = np.broadcast_to(poses[None, :, :3, 3], local.shape).copy()
    return Rays(origins, directions, np.broadcast_to(time[None], local.shape[:2]).copy())
