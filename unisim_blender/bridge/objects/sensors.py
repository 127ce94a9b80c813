"""Sensors' objects: camera models, where a sensor looks from the vehicle, and the drawn size of camera frustums.

A Blender camera's numbers are float32, so the exact model rides along, and is what counts as long as lens and shift are
as they were imported."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator

import bpy
import numpy as np
from mathutils import Matrix

from ...core.geometry import FloatArray
from ...core.world.drive import CameraModel
from ...editing.sampled.scene import rigid
from ...editing.sensors.lenses import BlenderLens, lens_of, model_of_lens
from ...editing.sensors.mounts import AHEAD, angles, turned_to
from .animation import curves_of
from .imported import ego_above, imported_objects

ROTATION_PATHS = ("rotation_quaternion", "rotation_euler", "rotation_axis_angle")
MIN_DISPLAY_SIZE_M = 0.01
"""The smallest size that Blender draws."""
DISPLAY_SIZE_KEY = "unisim_display_size"
"""A camera's custom property: the size to go back to, in metres."""


def set_model(obj: bpy.types.Object, model: CameraModel) -> None:
    """Give a camera object an exact model."""
    camera, lens = obj.data, lens_of(model)
    camera.sensor_fit, camera.sensor_width = lens.fit, lens.width_mm
    camera.lens, camera.shift_x, camera.shift_y = lens.focal_mm, lens.shift_x, lens.shift_y
    obj.unisim.model = json.dumps({"camera": model.to_dict(), "shown": _shown(camera)})


def _shown(camera: bpy.types.Camera) -> list[float]:
    return [camera.lens, camera.sensor_width, camera.shift_x, camera.shift_y]


def camera_model_of(obj: bpy.types.Object, size: tuple[int, int] | None = None) -> CameraModel:
    """The model of a camera object. ``size`` (width, height) is for one that has none of its own: the render's."""
    camera = obj.data
    stored = json.loads(obj.unisim.model) if obj.unisim.model else None
    exact = None
    if stored is not None:
        exact = CameraModel.from_dict(stored["camera"])
        if stored["shown"] == _shown(camera) and camera.sensor_fit == "HORIZONTAL":
            return exact
    lens = BlenderLens(
        camera.lens, camera.shift_x, camera.shift_y, camera.sensor_width, camera.sensor_height, camera.sensor_fit
    )
    return model_of_lens(lens, size, exact)


def direction_of(obj: bpy.types.Object) -> tuple[float, float]:
    """Return a sensor's yaw (to the left) and pitch (up) in radians, in the axes of `base_of`."""
    ahead = base_of(obj).T @ _turn(obj) @ np.array(AHEAD[obj.unisim.kind])
    return angles(ahead)


def base_of(obj: bpy.types.Object) -> FloatArray:
    """Return the axes (3, 3) of the vehicle that a sensor is mounted on; the world's where it is mounted on none."""
    ego = ego_above(obj)
    return np.eye(3) if ego is None else rigid(np.array(ego.matrix_world, float))[:3, :3]


def aim(obj: bpy.types.Object, yaw_rad: float, pitch_rad: float) -> None:
    """Turn a sensor on its mount until it looks along yaw and pitch; its place and its roll stay."""
    turned = turned_to(_turn(obj), base_of(obj), obj.unisim.kind, yaw_rad, pitch_rad)
    place, scale, location = obj.matrix_world.to_translation(), obj.matrix_world.to_scale(), tuple(obj.location)
    obj.matrix_world = Matrix.LocRotScale(place, Matrix(turned.tolist()), scale)
    obj.location = location  # what the matrix makes of it is off by a rounding


def is_keyed(obj: bpy.types.Object) -> bool:
    """Return whether keys turn a sensor on its mount, so that turning it by hand would not last."""
    return any(curve.data_path in ROTATION_PATHS for curve in curves_of(obj))


def _turn(obj: bpy.types.Object) -> FloatArray:
    return rigid(np.array(obj.matrix_world, float))[:3, :3]


def drawn_tiny(through: Iterable[bpy.types.Object | None]) -> bool:
    """Return whether frustums are to be drawn tiny, by the cameras that the views look through (None for no camera)."""
    return any(camera is not None and camera.unisim.kind == "CAMERA" for camera in through)


def frustums_differ(scene: bpy.types.Scene, tiny: bool) -> bool:
    """Return whether the frustum of some camera has another size than it is to have."""
    return any((DISPLAY_SIZE_KEY in camera) != tiny for camera in _cameras(scene))


def resize_frustums(scene: bpy.types.Scene, tiny: bool) -> None:
    """Draw the frustums of all cameras of the vehicle tiny, or as large as before."""
    for camera in _cameras(scene):
        if tiny and DISPLAY_SIZE_KEY not in camera:
            camera[DISPLAY_SIZE_KEY], camera.display_size = camera.display_size, MIN_DISPLAY_SIZE_M
        elif not tiny and DISPLAY_SIZE_KEY in camera:
            camera.display_size = camera[DISPLAY_SIZE_KEY]
            del camera[DISPLAY_SIZE_KEY]


def _cameras(scene: bpy.types.Scene) -> Iterator[bpy.types.Camera]:
    return (obj.data for obj in imported_objects(scene, "CAMERA"))
