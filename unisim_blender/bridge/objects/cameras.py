"""Camera models as Blender cameras, and back. A Blender camera's numbers are float32, so the exact model rides along,
and is what counts as long as lens and shift are as they were imported."""

from __future__ import annotations

import json

import bpy

from ...core.world.drive import CameraModel
from ...editing.sensors.lenses import BlenderLens, lens_of, model_of_lens


def set_model(obj: bpy.types.Object, model: CameraModel) -> None:
    """Give a camera object an exact model."""
    camera, lens = obj.data, lens_of(model)
    camera.sensor_fit, camera.sensor_width = lens.fit, lens.width_mm
    camera.lens, camera.shift_x, camera.shift_y = lens.focal_mm, lens.shift_x, lens.shift_y
    obj.unisim.model = json.dumps({"camera": model.to_dict(), "shown": _shown(camera)})


def _shown(camera: bpy.types.Camera) -> list[float]:
    return [camera.lens, camera.sensor_width, camera.shift_x, camera.shift_y]


def model_of(obj: bpy.types.Object, size: tuple[int, int] | None = None) -> CameraModel:
    """The model of a camera object. ``size`` (width, height) is for one that has none of its own: the render's."""
    camera = obj.data
    kept = json.loads(obj.unisim.model) if obj.unisim.model else None
    exact = None
    if kept is not None:
        exact = CameraModel.from_dict(kept["camera"])
        if kept["shown"] == _shown(camera) and camera.sensor_fit == "HORIZONTAL":
            return exact
    lens = BlenderLens(
        camera.lens, camera.shift_x, camera.shift_y, camera.sensor_width, camera.sensor_height, camera.sensor_fit
    )
    return model_of_lens(lens, size, exact)
