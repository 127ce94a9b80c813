"""Cameras that Cycles has no model for, drawn by a table of their pixels' directions: a camera shader looks rays up in it.

The table is `sensors.unprojection`'s, finer than the pixels, so that rays between its entries are off by a small part of a pixel.
Cycles exposes rows one after the other; where a shutter reads columns, table and image are transposed.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

import _cycles
import bpy
import numpy as np

from unisim_blender.core.errors import OutputError
from unisim_blender.core.files import write_file
from unisim_blender.core.sensors.camera import pixel_directions
from unisim_blender.core.world.drive import CameraModel

FINER = 3
"""Entries of the table a pixel, along each side: odd, for the middle of a pixel to have one. At a focal length of f pixels a ray
between n of them is off by about 1 / (8 n^2 f) pixels, so large images, of large f, do with one a pixel."""
MOST_ENTRIES = 1 << 23
_SHADER = """
shader camera(string table = "{table}",
              output point position = 0.0,
              output vector direction = 0.0,
              output color throughput = 1.0)
{{
  point at = camera_shader_raster_position();
  color ray = texture(table, at.x, 1.0 - at.y, 0.0, 0.0, 0.0, 0.0, "wrap", "clamp", "interp", "linear");
  direction = normalize(vector(ray[0], -ray[1], ray[2]));
}}
"""
"""Cycles' raster runs from the lower left corner, its camera's axes are x right, y up, z forward."""


def is_transposed(model: CameraModel) -> bool:
    """Return whether the image is drawn with its columns as rows."""
    return model.shutter.axis == "columns"


def needs_table(model: CameraModel) -> bool:
    """Return whether Cycles' own camera cannot draw an image."""
    return not model.is_pinhole or is_transposed(model)


def set_table_camera(camera: bpy.types.Camera, model: CameraModel, folder: Path) -> None:
    """Make a camera one of the model's directions; table and shader are written to ``folder``. Raises `OutputError`."""
    finer = FINER if model.height * model.width * FINER**2 <= MOST_ENTRIES else 1
    v, u = ((np.arange(count * finer) + 0.5) / finer for count in (model.height, model.width))
    rays = pixel_directions(model, u[None], v[:, None])
    rays = rays.swapaxes(0, 1) if is_transposed(model) else rays
    # a table's name is its content's: Cycles keeps textures by their names
    name = hashlib.sha256(np.ascontiguousarray(rays).tobytes()).hexdigest()[:16]
    table, source, compiled = (folder / f"rays-{name}.{end}" for end in ("exr", "osl", "oso"))
    if not compiled.exists():
        _write_table(table, rays.astype(np.float32))
        write_file(source, _SHADER.format(table=table.as_posix()).encode())
        if not _cycles.osl_compile(str(source), str(compiled)):
            raise OutputError(f"{source}: Cycles cannot compile the camera's shader")
    code = compiled.read_text()
    camera.type, camera.custom_mode = "CUSTOM", "INTERNAL"
    # what setting a text would do, for which Blender's module lacks the part that lists parameters
    camera.custom_bytecode = code
    camera.custom_bytecode_hash = hashlib.md5(code.encode(), usedforsecurity=False).hexdigest()


def _write_table(path: Path, rays: np.ndarray[tuple[int, ...], np.dtype[np.float32]]) -> None:
    """Write directions (h, w, 3), first row uppermost, as an image of floats."""
    height, width = rays.shape[:2]
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = rays[::-1]
    image = bpy.data.images.new(path.stem, width, height, float_buffer=True, alpha=False)
    try:
        image.colorspace_settings.name = "Non-Color"
        image.pixels.foreach_set(pixels.reshape(-1))
        image.file_format, image.filepath_raw = "OPEN_EXR", str(path)
        image.save()
    finally:
        bpy.data.images.remove(image)
