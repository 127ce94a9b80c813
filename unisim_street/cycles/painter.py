"""An image's setup into Blender's scene, and Cycles' image of it.

Blender's time is the shutter's: from frame 0 to frame 1 an image's rows are exposed, so that Cycles' rolling shutter
over one frame is the camera's own. Camera: OpenCV's axes become Blender's, y and z turned round. Cameras with a lens, or a
shutter that reads columns, are drawn by a table of their pixels' directions, in which a camera shader looks rays up.

The table is `sensors.unprojection`'s, finer than the pixels, so that rays between its entries are off by a small part of a pixel.
Cycles exposes rows one after the other; where a shutter reads columns, table and image are transposed.
"""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Sequence
from pathlib import Path

import bpy
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from unisim_blender.bridge.objects.animation import LINEAR, add_keys, fcurves_of
from unisim_blender.core.errors import OutputError
from unisim_blender.core.files import write_file
from unisim_blender.core.geometry import FloatArray, quaternion_from_matrix
from unisim_blender.core.sensors.camera import pixel_directions
from unisim_blender.core.sensors.unprojection import image_mask
from unisim_blender.core.world.drive import CameraModel

from ..drawing.atlas import AssetModel
from ..drawing.image_setup import SHUTTER_KEYS, DrawnModel, ImageSetup
from ..paint.light import DAY, StreetLight
from ..paint.materials import Finish
from .surfaces import add_daylight, add_night, image_of, material_of

TABLE_ENTRIES_PER_PIXEL = 3
"""Entries of the table a pixel, along each side: odd, for the middle of a pixel to have one. At a focal length of f pixels a ray
between n of them is off by about 1 / (8 n^2 f) pixels, so large images, of large f, do with one a pixel."""
MAX_TABLE_ENTRIES = 1 << 23
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
    finer = (
        TABLE_ENTRIES_PER_PIXEL if model.height * model.width * TABLE_ENTRIES_PER_PIXEL**2 <= MAX_TABLE_ENTRIES else 1
    )
    v, u = ((np.arange(count * finer) + 0.5) / finer for count in (model.height, model.width))
    rays = pixel_directions(model, u[None], v[:, None])
    rays = rays.swapaxes(0, 1) if is_transposed(model) else rays
    # a table's name is its content's: Cycles keeps textures by their names
    name = hashlib.sha256(np.ascontiguousarray(rays).tobytes()).hexdigest()[:16]
    table, source, compiled = (folder / f"rays-{name}.{end}" for end in ("exr", "osl", "oso"))
    if not compiled.exists():
        _write_table(table, rays.astype(np.float32))
        write_file(source, _SHADER.format(table=table.as_posix()).encode())
        import _cycles  # Blender's module brings it, and only once it is imported

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


SENSOR_MM = 36.0
EXPOSURE = 1.0
BOUNCES = 4
CLIP_M = (0.01, 5000.0)
_BLENDER_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


class CyclesPainter:
    """Renders images, one after the other; what stays between two is not loaded again. ``paths``:
    Cycles' paths a pixel."""

    def __init__(self, paths: int, light: StreetLight = DAY) -> None:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self.scene = bpy.context.scene
        self._meshes: dict[AssetModel, bpy.types.Mesh] = {}
        self._objects: dict[str, bpy.types.Object] = {}
        self._images: dict[int, bpy.types.Image] = {}
        self._materials: dict[tuple[int, Finish, bool], bpy.types.Material] = {}
        self._tables = tempfile.TemporaryDirectory(prefix="unisim-cycles-")
        self._camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        self.scene.collection.objects.link(self._camera)
        self.scene.camera = self._camera
        if len(light.lamps):
            add_night(self.scene, light)
        else:
            add_daylight(self.scene)
        self._set_up(paths)

    def _set_up(self, paths: int) -> None:
        scene, render, cycles = self.scene, self.scene.render, self.scene.cycles
        render.engine = "CYCLES"
        cycles.device, cycles.samples = "CPU", paths
        cycles.use_adaptive_sampling, cycles.adaptive_threshold = True, 0.01
        cycles.adaptive_min_samples = max(1, paths // 4)
        cycles.sampling_pattern = "BLUE_NOISE"
        cycles.max_bounces = cycles.glossy_bounces = cycles.transmission_bounces = BOUNCES
        cycles.diffuse_bounces, cycles.transparent_max_bounces = 3, 4
        cycles.caustics_reflective = cycles.caustics_refractive = False
        cycles.sample_clamp_indirect = 6.0
        cycles.pixel_filter_type = "BOX"  # a pixel is the mean over its own square, as the camera's model has it
        cycles.filter_width = 1.0
        cycles.use_denoising, cycles.denoiser = True, "OPENIMAGEDENOISE"
        cycles.denoising_input_passes, cycles.denoising_prefilter = "RGB_ALBEDO_NORMAL", "ACCURATE"
        cycles.rolling_shutter_type, cycles.rolling_shutter_duration = "TOP", 0.0
        render.use_motion_blur, render.motion_blur_shutter, render.motion_blur_position = True, 1.0, "START"
        render.use_persistent_data = True
        render.film_transparent = False
        render.dither_intensity = 0.0
        scene.display_settings.display_device = "sRGB"
        scene.view_settings.view_transform, scene.view_settings.look = "Standard", "None"
        cycles.film_exposure = EXPOSURE
        render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGB"
        render.image_settings.color_depth = "8"
        scene.frame_set(0)

    def paint(self, setup: ImageSetup, noise_seed: int = 0) -> NDArray[np.uint8]:
        """The image (H, W, 3), sRGB."""
        self.set_up_image(setup, noise_seed)
        with tempfile.TemporaryDirectory(prefix="unisim-cycles-") as folder:
            path = Path(folder) / "image.png"
            self.scene.render.filepath = str(path)
            bpy.ops.render.render(write_still=True)
            with Image.open(path) as image:
                rgb = np.asarray(image.convert("RGB"), np.uint8)
        if is_transposed(setup.camera.model):
            rgb = rgb.swapaxes(0, 1)
        shown = image_mask(setup.camera.model)
        return rgb if shown is None else np.where(shown[..., None], rgb, np.uint8(0))

    def set_up_image(self, setup: ImageSetup, noise_seed: int) -> None:
        """Put what an image shows into the scene."""
        self.scene.cycles.seed = noise_seed
        self._set_camera(setup.camera.model)
        rolling = setup.camera.model.shutter.duration_s != 0
        self.scene.cycles.rolling_shutter_type = "TOP" if rolling else "NONE"
        self.scene.render.use_motion_blur = rolling
        _move(self._camera, setup.poses @ _BLENDER_FROM_OPENCV)
        wanted = {item.name: item for item in setup.items}
        for name, obj in self._objects.items():
            obj.hide_render = name not in wanted
        for name, item in wanted.items():
            self._put(name, item)

    def _set_camera(self, model: CameraModel) -> None:
        by_table = needs_table(model)
        self.scene.cycles.shading_system = by_table
        if not by_table:
            _set_lens(self.scene, self._camera.data, model)
            return
        size = (model.height, model.width) if is_transposed(model) else (model.width, model.height)
        render = self.scene.render
        render.resolution_x, render.resolution_y, render.resolution_percentage = *size, 100
        render.pixel_aspect_x = render.pixel_aspect_y = 1.0
        self._camera.data.clip_start, self._camera.data.clip_end = CLIP_M
        set_table_camera(self._camera.data, model, Path(self._tables.name))

    def _put(self, name: str, item: DrawnModel) -> None:
        mesh = self._mesh(item.model)
        obj = self._objects.get(name)
        if obj is None:
            obj = self._objects[name] = bpy.data.objects.new(name, mesh)
            self.scene.collection.objects.link(obj)
        elif obj.data != mesh:
            obj.data = mesh
        obj.hide_render = False
        obj.scale = item.scale
        _move(obj, item.poses)

    def _mesh(self, model: AssetModel) -> bpy.types.Mesh:
        if model not in self._meshes:
            materials = [self._material(model.pages[page], finish, glass) for page, finish, glass in model.surfaces]
            self._meshes[model] = _mesh_of(f"mesh {len(self._meshes)}", model, materials)
        return self._meshes[model]

    def _material(self, page: NDArray[np.uint8], finish: Finish, glass: bool) -> bpy.types.Material:
        # pages live as long as their models do, which this keeps
        if id(page) not in self._images:
            self._images[id(page)] = image_of(f"page {len(self._images)}", page)
        key = (id(page), finish, glass)
        if key not in self._materials:
            self._materials[key] = material_of(f"surface {len(self._materials)}", self._images[id(page)], finish, glass)
        return self._materials[key]


def _mesh_of(name: str, model: AssetModel, materials: Sequence[bpy.types.Material]) -> bpy.types.Mesh:
    """The model's triangles, those that share corners and normals joined there."""
    rows = np.concatenate([model.corners, model.normals], -1).reshape(-1, 6)
    rounded = np.round(rows.astype(np.float64), 5)
    _, first, which = np.unique(rounded, axis=0, return_index=True, return_inverse=True)
    count = len(model.corners)
    mesh = bpy.data.meshes.new(name)
    mesh.vertices.add(len(first))
    mesh.vertices.foreach_set("co", rows[first, :3].reshape(-1))
    mesh.loops.add(3 * count)
    mesh.loops.foreach_set("vertex_index", which.reshape(-1).astype(np.int32))
    mesh.polygons.add(count)
    mesh.polygons.foreach_set("loop_start", np.arange(0, 3 * count, 3, dtype=np.int32))
    for material in materials:
        mesh.materials.append(material)
    mesh.polygons.foreach_set("material_index", model.surface)
    layer = mesh.uv_layers.new(name="atlas")
    layer.uv.foreach_set("vector", model.uv.reshape(-1))
    mesh.update(calc_edges=True)
    mesh.normals_split_custom_set(model.normals.reshape(-1, 3))
    return mesh


def _set_lens(scene: bpy.types.Scene, camera: bpy.types.Camera, model: CameraModel) -> None:
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = model.width, model.height, 100
    render.pixel_aspect_x, render.pixel_aspect_y = (
        (1.0, model.fx / model.fy) if model.fx >= model.fy else (model.fy / model.fx, 1.0)
    )
    camera.type = "PERSP"
    camera.sensor_fit, camera.sensor_width = "HORIZONTAL", SENSOR_MM
    camera.lens = model.fx / model.width * SENSOR_MM
    camera.shift_x = (model.width / 2 - model.cx) / model.width
    camera.shift_y = (model.cy - model.height / 2) / model.width
    camera.clip_start, camera.clip_end = CLIP_M


def _move(obj: bpy.types.Object, poses: FloatArray) -> None:
    """Give an object its poses (K, 4, 4) over frame 0 to 1, or one (1, 4, 4) for good."""
    obj.rotation_mode = "QUATERNION"
    quaternions = quaternion_from_matrix(poses[:, :3, :3]).reshape(-1, 4)
    signs = np.sign((quaternions * quaternions[:1]).sum(1, keepdims=True))
    quaternions = quaternions * np.where(signs == 0, 1.0, signs)
    obj.location, obj.rotation_quaternion = poses[0, :3, 3], quaternions[0]
    still = len(poses) == 1
    obj.cycles.use_motion_blur = not still
    if still:
        obj.animation_data_clear()
        return
    obj.cycles.motion_steps = (SHUTTER_KEYS - 1).bit_length() - 1  # of n, Cycles makes 2 ** n + 1
    frames = np.linspace(0.0, 1.0, len(poses))
    curves = fcurves_of(obj, obj.name)
    add_keys(curves, "location", frames, poses[:, :3, 3], LINEAR)
    add_keys(curves, "rotation_quaternion", frames, quaternions, LINEAR)
