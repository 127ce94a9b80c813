"""Where moved sensors were recorded, as lines for the view."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.geometry import transform_points
from ...core.world.drive import Camera, Drive
from ...editing.motion.trails import RECORDED, TrailSegments
from ...editing.sampled.poses import rigid, same
from ...editing.sensors.outlines import pyramid, ring
from ...editing.sensors.recorded import recorded_pose
from .sensor_facts import recorded_sensor


def outline(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive, frame: float) -> TrailSegments:
    """Return the outline of a recorded sensor, a camera's pyramid or a LiDAR's ring, where it was recorded at a frame,
    and a line from there to where it is now. Empty for a sensor that stands there still, and for one
    that no log has."""
    sensor = recorded_sensor(scene, obj, drive)
    here = rigid(np.array(obj.matrix_world, float))
    pose = None if sensor is None else recorded_pose(sensor, drive, frame)
    if sensor is None or pose is None or same(here, pose).all():
        return TrailSegments(np.zeros((0, 3)), np.zeros((0, 4)))
    shape = pyramid(sensor) if isinstance(sensor, Camera) else ring()
    points = np.concatenate([transform_points(pose, shape), [pose[:3, 3], here[:3, 3]]])
    return TrailSegments(points, np.tile([*RECORDED, 1.0], (len(points), 1)))
