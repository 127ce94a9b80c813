"""Camera models as Blender cameras, and back. A Blender camera has one focal length and its numbers are float32, so the exact
model rides along, and is what counts as long as lens and shift are as they were imported."""

from __future__ import annotations

import json
from dataclasses import asdict, replace

import bpy

from ...core.world.drive import CameraModel

SENSOR_MM = 36.0


def set_model(thing: bpy.types.Object, model: CameraModel) -> None:
    """Give a camera object an exact model."""
    camera = thing.data
    camera.sensor_fit, camera.sensor_width = "HORIZONTAL", SENSOR_MM
    camera.lens = model.fx / model.width * SENSOR_MM
    camera.shift_x = (model.width / 2 - model.cx) / model.width
    camera.shift_y = (model.cy - model.height / 2) / model.width
    thing.unisim.model = json.dumps({"camera": asdict(model), "shown": _shown(camera)})


def _shown(camera: bpy.types.Camera) -> list[float]:
    return [camera.lens, camera.sensor_width, camera.shift_x, camera.shift_y]


def model_of(thing: bpy.types.Object, size: tuple[int, int] | None = None) -> CameraModel:
    """The model of a camera object. ``size`` (width, height) is for one that has none of its own: the render's."""
    camera = thing.data
    kept = json.loads(thing.unisim.model) if thing.unisim.model else None
    exact = None
    if kept is not None:
        exact = CameraModel.from_dict(kept["camera"])
        if kept["shown"] == _shown(camera) and camera.sensor_fit == "HORIZONTAL":
            return exact
    width, height = (exact.width, exact.height) if exact is not None else size or (960, 540)
    along = max(width, height) if camera.sensor_fit == "AUTO" else width if camera.sensor_fit == "HORIZONTAL" else height
    millimetres = camera.sensor_height if camera.sensor_fit == "VERTICAL" else camera.sensor_width
    focal = camera.lens / millimetres * along
    plain = CameraModel(width, height, focal, focal, width / 2 - camera.shift_x * along, height / 2 + camera.shift_y * along)
    return plain if exact is None else replace(plain, fy=focal * exact.fy / exact.fx, shutter=exact.shutter)
