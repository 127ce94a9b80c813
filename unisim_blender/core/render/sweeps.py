"""Sweeps from what their beams measure: which of them return is drawn by their probability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..sensors.frames import LidarFrame, RenderStats
from ..sensors.rays import Rays
from ..world.drive import Lidar


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
    """Return the sweep of what its beams measure. Those return whose probability is 0.5 or more, or a number in (0, 1] that is
    drawn with the seed."""
    shape = rays.time_s.shape
    least: FloatArray | float = 0.5 if seed is None else 1.0 - np.random.default_rng(seed).random(shape)
    depth, model = measured.depth_m, lidar.model
    returned = (measured.return_probability >= least) & (depth >= model.min_range_m) & (depth <= model.max_range_m)
    if lidar.blocked is not None:
        returned &= ~lidar.blocked
    return LidarFrame(
        lidar.model_at(time_s), lidar.world_from_lidar.at(time_s), rays.origins, rays.directions, rays.time_s,
        depth, measured.intensity, measured.return_probability, returned, measured.instance, instances, stats,
    )  # fmt: skip
