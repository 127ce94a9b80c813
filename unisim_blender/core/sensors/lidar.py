"""LiDAR rays: every cell of beams x columns, at its own time, from where the sensor was then; and sweeps from what the
beams measure, where each return is drawn by its probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..world.drive import Lidar, LidarModel
from .frames import LidarFrame, RenderStats
from .rays import Rays


def column_azimuths(model: LidarModel) -> FloatArray:
    """Return azimuths (columns,) without the beams' offsets, radians."""
    if model.column_azimuth_rad is not None:
        return model.column_azimuth_rad
    return model.start_azimuth_rad + model.direction * 2 * np.pi * (np.arange(model.columns) + 0.5) / model.columns


ALL = slice(None)


def beam_directions(model: LidarModel, beams: slice = ALL, columns: slice = ALL) -> FloatArray:
    """Return unit directions (beams, columns, 3), of all or of some, in the sensor's frame."""
    azimuth = column_azimuths(model)[None, columns] + model.azimuth_offset_rad[beams, None]
    elevation = np.broadcast_to(model.elevation_rad[beams, None], azimuth.shape)
    cosine = np.cos(elevation)
    return np.stack([cosine * np.cos(azimuth), cosine * np.sin(azimuth), np.sin(elevation)], -1)


def column_times(lidar: Lidar, time_s: float) -> FloatArray:
    """Return the time (columns,), seconds, of each column of the sweep at ``time_s``, without the beams' own delays."""
    model = lidar.model
    if model.column_time_s is not None:
        return time_s + model.time_offset_s + model.column_time_s
    fraction = (np.arange(model.columns) + 0.5) / model.columns
    return time_s + model.time_offset_s + model.sweep_s * (fraction - 1)


def beam_times(lidar: Lidar, time_s: float, beams: slice = ALL, columns: slice = ALL) -> FloatArray:
    """Return the times (beams, columns), of all or of some, seconds, at which the beams of the sweep at ``time_s`` leave."""
    times, delays = column_times(lidar, time_s)[None, columns], lidar.model.beam_time_s
    count = len(lidar.model.elevation_rad[beams])
    return np.repeat(times, count, 0) if delays is None else times + delays[beams, None]


def same_directions(a: LidarModel, b: LidarModel) -> bool:
    """Return whether two beam tables have the same `beam_directions`, to the bit."""
    tables = ((m.elevation_rad, m.azimuth_offset_rad, column_azimuths(m)) for m in (a, b))
    return all(np.array_equal(x, y) for x, y in zip(*tables, strict=True))


def lidar_rays(lidar: Lidar, time_s: float, beams: slice = ALL, columns: slice = ALL) -> Rays:
    """Return rays (beams, columns), all or some, of the sweep at ``time_s``, world frame."""
    local = beam_directions(lidar.model_at(time_s), beams, columns)
    fired = beam_times(lidar, time_s, beams, columns)
    if lidar.model.beam_time_s is not None:
        poses = lidar.world_from_lidar.at(fired.ravel()).reshape(*fired.shape, 4, 4)
        return Rays(poses[..., :3, 3].copy(), np.einsum("bcij,bcj->bci", poses[..., :3, :3], local), fired)
    poses = lidar.world_from_lidar.at(fired[0])
    directions = np.einsum("cij,bcj->bci", poses[:, :3, :3], local)
    origins = np.broadcast_to(poses[None, :, :3, 3], local.shape).copy()
    return Rays(origins, directions, fired)


class BeamMeasurements(NamedTuple):
    """Measurements of beams (B, C): see `LidarFrame`."""

    depth_m: NDArray[np.float32]
    intensity: NDArray[np.float32]
    return_probability: NDArray[np.float32]
    instance: NDArray[np.int32]


def sweep_frame(
    lidar: Lidar,
    time_s: float,
    rays: Rays,
    measured: BeamMeasurements,
    instances: tuple[str, ...],
    seed: Sequence[int] | None,
    stats: RenderStats,
) -> LidarFrame:
    """Return the sweep of measurements of its rays (B, C). Beams return whose probability is 0.5 or more, or with a
    seed, at least a number drawn from (0, 1]."""
    shape = rays.time_s.shape
    assert all(values.shape == shape for values in measured), (shape, [values.shape for values in measured])
    least: FloatArray | float = 0.5 if seed is None else 1.0 - np.random.default_rng(seed).random(shape)
    depth, model = measured.depth_m, lidar.model
    returned = (measured.return_probability >= least) & (depth >= model.min_range_m) & (depth <= model.max_range_m)
    if lidar.blocked is not None:
        returned &= ~lidar.blocked
    return LidarFrame(
        lidar.model_at(time_s), lidar.world_from_lidar.at(time_s), rays.origins, rays.directions, rays.time_s,
        depth, measured.intensity, measured.return_probability, returned, measured.instance, instances, stats,
    )  # fmt: skip
