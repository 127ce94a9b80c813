"""Sweeps as the renderer's data that drivers of `carla-driver-interface` read: AlpaSim's driver service has no call for LiDAR."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...geometry import FloatArray, transform_points
from .poses import pose_message
from .protos import LidarSweep


def sweep_message(
    name: str, time_us: int, rig_from_lidar: FloatArray, points: FloatArray, intensity: NDArray[np.float32]
) -> Any:
    """Return a sweep's message: ``points`` (N, 3) in the LiDAR's frame at ``time_us``, ``intensity`` (N,) from 0 to 1. The
    message has points in the rig's frame."""
    rows = np.column_stack([transform_points(rig_from_lidar, points), intensity]).astype("<f4")
    return LidarSweep(
        logical_id=name,
        timestamp_us=time_us,
        rig_to_lidar=pose_message(rig_from_lidar),
        num_points=len(rows),
        points_xyzi=rows.tobytes(),
    )
