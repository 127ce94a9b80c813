"""Where a sensor looks from the vehicle, as yaw and pitch, and its mount turned to look elsewhere."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ...core.geometry import FloatArray
from ...editing.sampled.scene import rigid
from ...editing.sensors.mounts import AHEAD, angles, turned_to
from ..objects.animation import curves_of

ROTATIONS = ("rotation_quaternion", "rotation_euler", "rotation_axis_angle")


def direction_of(obj: bpy.types.Object) -> tuple[float, float]:
    """Return a sensor's yaw (to the left) and pitch (up) in radians, in the axes of `base_of`."""
    ahead = base_of(obj).T @ _turn(obj) @ np.array(AHEAD[obj.unisim.kind])
    return angles(ahead)


def base_of(obj: bpy.types.Object) -> FloatArray:
    """Return the axes (3, 3) of the vehicle that a sensor is mounted on; the world's where it is mounted on none."""
    above = obj.parent
    while above is not None and above.unisim.kind != "EGO":
        above = above.parent
    return np.eye(3) if above is None else rigid(np.array(above.matrix_world, float))[:3, :3]


def aim(obj: bpy.types.Object, yaw_rad: float, pitch_rad: float) -> None:
    """Turn a sensor on its mount until it looks along yaw and pitch; its place and its roll stay."""
    turned = turned_to(_turn(obj), base_of(obj), obj.unisim.kind, yaw_rad, pitch_rad)
    place, scale, location = obj.matrix_world.to_translation(), obj.matrix_world.to_scale(), tuple(obj.location)
    obj.matrix_world = Matrix.LocRotScale(place, Matrix(turned.tolist()), scale)
    obj.location = location  # what the matrix makes of it is off by a rounding


def is_keyed(obj: bpy.types.Object) -> bool:
    """Return whether keys turn a sensor on its mount, so that turning it by hand would not last."""
    return any(curve.data_path in ROTATIONS for curve in curves_of(obj))


def _turn(obj: bpy.types.Object) -> FloatArray:
    return rigid(np.array(obj.matrix_world, float))[:3, :3]
