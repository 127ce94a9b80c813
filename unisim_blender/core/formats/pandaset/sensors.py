"""PandaSet's sensors: names, mounts, how the Pandar64 turns, and when images' rows are exposed.

The log's lidar pose is the vehicle's, x right, y forward, z up; ours is x forward, y left. The mounts are given in
ours. They were fitted to sequence 002 (points of a standing vehicle lie within 0.007 degrees of the beams' elevations,
median), and PandaSet was recorded with one vehicle throughout.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...geometry import FloatArray, make_pose
from ...sensors import beam_tables
from ...world.drive import LidarModel, RollingShutter

CAMERAS = ("front_camera", "front_left_camera", "front_right_camera", "left_camera", "right_camera", "back_camera")
PANDAR64, PANDAR_GT = "pandar64", "pandar_gt"
DEVICES = {PANDAR64: 0, PANDAR_GT: 1}
"""Values of a sweep's column ``d``."""

PANDASET_EGO_FROM_EGO_WXYZ = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])
"""Our vehicle axes (x forward) in PandaSet's (y forward): a quarter turn about z."""

ROLLING_SHUTTER = RollingShutter(duration_s=0.030, reference=1.0)
"""PandaSet's cameras: some 30 ms from the top row to the bottom one, the timestamp at the last row.

On sequence 002, LiDAR's depth edges fall on the images' best for poses 10 to 24 ms before the timestamp (five cameras,
by the shift's slope over the vehicle's speed), so the middle row is some 15 ms earlier. The duration is the usual
one, not measured.
"""

BODY_MIN_M, BODY_MAX_M = np.array([-1.5, -0.9, 0.3]), np.array([1.5, 0.9, 1.7])
"""Box in the ego frame in which a return comes from the vehicle's own roof."""


def pandar64() -> LidarModel:
    """PandaSet's Pandar64: its first column looks to the rear, and the frame's time is 0.1 ms before
    the sweep's end."""
    return replace(beam_tables.pandar64(), start_azimuth_rad=float(np.radians(181.872)), time_offset_s=0.0001)


def pandar_gt() -> LidarModel:
    """The PandarGT scans no grid of beams: its model has none, and its sweeps are plain points."""
    return LidarModel(elevation_rad=np.zeros(0), azimuth_offset_rad=np.zeros(0), columns=1, max_range_m=300.0)


def ego_from_lidar(lidar: str) -> FloatArray:
    """Where a LiDAR sits in the ego frame (4, 4), its axes x forward, y left, z up."""
    if lidar == PANDAR_GT:
        return make_pose(np.array([1.391, 0.016, 1.565]), np.array([1.0, 0.0, 0.0, 0.0]))
    tilt = np.array([-0.000548, -0.015726])  # about x and y, so small that their order does not matter
    quaternion = np.array([1.0, *(tilt / 2), 0.0])
    return make_pose(np.array([0.7807, -0.0023, 1.8568]), quaternion / np.linalg.norm(quaternion))
