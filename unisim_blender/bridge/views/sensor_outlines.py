"""Where moved sensors were recorded, as lines for the view."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.geometry import FloatArray, transform_points
from ...core.world.drive import Camera, Drive
from ...editing.sampled.poses import rigid, same
from ..importing.drive import DISPLAY_M
from .sensor_facts import recorded_pose, recorded_sensor
from .trails import RECORDED, Lines

RING = 24
"""Points of a LiDAR's ring."""


def outline(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive, frame: float) -> Lines:
    """Return the outline of a recorded sensor, a camera's pyramid or a LiDAR's ring, where it was recorded at a frame, and a line
    from there to where it is now. Empty for a sensor that stands there still, and for one that no log has."""
    sensor = recorded_sensor(scene, thing, drive)
    here = rigid(np.array(thing.matrix_world, float))
    pose = None if sensor is None else recorded_pose(sensor, drive, frame)
    if sensor is None or pose is None or same(here, pose).all():
        return Lines(np.zeros((0, 3)), np.zeros((0, 4)))
    shape = _pyramid(sensor) if isinstance(sensor, Camera) else _ring()
    points = np.concatenate([transform_points(pose, shape), [pose[:3, 3], here[:3, 3]]])
    return Lines(points, np.tile([*RECORDED, 1.0], (len(points), 1)))


def _pyramid(camera: Camera) -> FloatArray:
    """A camera's pyramid as segments (2 S, 3), Blender's camera axes."""
    model = camera.model
    x, y, z = DISPLAY_M / 2, DISPLAY_M / 2 * model.height / model.width, DISPLAY_M * model.fx / model.width
    corners = [np.array([sx * x, sy * y, -z]) for sx, sy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    around = [(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    rays = [(np.zeros(3), corner) for corner in corners]
    roof = [(corners[2], np.array([0.0, 1.6 * y, -z])), (np.array([0.0, 1.6 * y, -z]), corners[3])]  # tells up from down
    return np.array([*around, *rays, *roof]).reshape(-1, 3)


def _ring() -> FloatArray:
    """A LiDAR's ring, with a mark that points along its x, as segments (2 S, 3)."""
    angle = np.linspace(0, 2 * np.pi, RING + 1)
    ring = DISPLAY_M / 2 * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], -1)
    ahead = np.array([[0.0, 0.0, 0.0], [DISPLAY_M, 0.0, 0.0]])
    return np.concatenate([np.stack([ring[:-1], ring[1:]], 1).reshape(-1, 3), ahead])
