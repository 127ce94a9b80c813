"""LiDAR rays: every cell of beams x columns, at its own time, from where the sensor was then."""

from __future__ import annotations

import numpy as np

from ..geometry import FloatArray
from ..world.drive import Lidar, LidarModel
from .rays import Rays


def column_azimuths(model: LidarModel) -> FloatArray:
    """Azimuths (columns,) without the beams' offsets, radians."""
    if model.column_azimuth_rad is not None:
        return model.column_azimuth_rad
    return model.start_azimuth_rad + model.direction * 2 * np.pi * (np.arange(model.columns) + 0.5) / model.columns


def beam_directions(model: LidarModel) -> FloatArray:
    """Unit directions (beams, columns, 3) in the sensor's frame."""
    azimuth = column_azimuths(model)[None, :] + model.azimuth_offset_rad[:, None]
    elevation = np.broadcast_to(model.elevation_rad[:, None], azimuth.shape)
    cosine = np.cos(elevation)
    return np.stack([cosine * np.cos(azimuth), cosine * np.sin(azimuth), np.sin(elevation)], -1)


def column_times(lidar: Lidar, time_s: float) -> FloatArray:
    """When each column of the sweep at ``time_s`` is fired (columns,), without the beams' own delays."""
    model = lidar.model
    if model.column_time_s is not None:
        return time_s + model.time_offset_s + model.column_time_s
    fraction = (np.arange(model.columns) + 0.5) / model.columns
    return time_s + model.time_offset_s + model.sweep_s * (fraction - 1)


def lidar_rays(lidar: Lidar, time_s: float) -> Rays:
    """Rays (beams, columns) of the sweep at ``time_s``, in the world frame."""
    local = beam_directions(lidar.model_at(time_s))
    time = column_times(lidar, time_s)
    if lidar.model.beam_time_s is not None:
        fired = time[None] + lidar.model.beam_time_s[:, None]
        poses = lidar.world_from_lidar.at(fired.ravel()).reshape(*fired.shape, 4, 4)
        return Rays(poses[..., :3, 3].copy(), np.einsum("bcij,bcj->bci", poses[..., :3, :3], local), fired)
    poses = lidar.world_from_lidar.at(time)
    directions = np.einsum("cij,bcj->bci", poses[:, :3, :3], local)
    origins = np.broadcast_to(poses[None, :, :3, 3], local.shape).copy()
    return Rays(origins, directions, np.broadcast_to(time[None], local.shape[:2]).copy())
