"""Outlines of boxes in the view through a camera whose lens bends lines. Blender itself draws boxes through a pinhole, which
is not where the recorded and the rendered image show things."""

from __future__ import annotations

import bpy
import numpy as np

from ..bridge.objects.cameras import model_of
from ..bridge.objects.imported import imported_objects
from ..core.geometry import FloatArray, invert_pose
from ..editing.sampled.scene import optical, rigid
from ..editing.sensors.lenses import bent_edges, corners
from ..registering import Drawing
from .view_types import looks_through
from .views import camera_rectangle

COLOUR, CHOSEN, ACTIVE = (1.0, 1.0, 1.0, 0.7), (0.95, 0.45, 0.1, 1.0), (1.0, 0.65, 0.25, 1.0)
KINDS = ("ACTOR", "BODY")


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    context = bpy.context
    scene, space = context.scene, context.space_data
    if not scene.unisim.log or not space.overlay.show_overlays or looks_through(scene, space) != "RIG":
        return
    found = outlines(scene, context.view_layer)
    if not found:
        return
    points = np.concatenate([segments for segments, _ in found]).reshape(-1, 2)
    colours = np.repeat([colour for _, colour in found], [2 * len(segments) for segments, _ in found], 0)
    left, bottom, width, height = camera_rectangle(context, scene)
    model = model_of(scene.camera)
    places = np.zeros((len(points), 3), np.float32)
    places[:, 0] = left + points[:, 0] / model.width * width
    places[:, 1] = bottom + (1 - points[:, 1] / model.height) * height
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": places, "color": colours.astype(np.float32)})
    gpu.state.blend_set("ALPHA")
    gpu.state.line_width_set(1.5)
    batch.draw(shader)
    gpu.state.line_width_set(1.0)
    gpu.state.blend_set("NONE")


def outlines(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer
) -> list[tuple[FloatArray, tuple[float, float, float, float]]]:
    """Return the outline of each box in the image of the active camera, segments (S, 2, 2) in pixels, and its colour; none
    where the lens bends no lines."""
    model = model_of(scene.camera)
    if model.is_pinhole:
        return []
    camera_from_world = invert_pose(rigid(optical(np.array(scene.camera.matrix_world, float))))
    found = []
    for kind in KINDS:
        for obj in imported_objects(scene, kind):
            if obj.type != "MESH" or not obj.visible_get(view_layer=layer):
                continue
            box = np.array(obj.bound_box)
            move = camera_from_world @ np.array(obj.matrix_world, float)
            segments = bent_edges(model, move, corners(box.min(0), box.max(0)))
            if len(segments):
                chosen = obj.select_get(view_layer=layer)
                active = chosen and layer.objects.active == obj
                found.append((segments, ACTIVE if active else CHOSEN if chosen else COLOUR))
    return found


_drawing = Drawing(draw, "POST_PIXEL")


def register() -> None:
    """Draw from now on."""
    _drawing.begin()


def unregister() -> None:
    """Draw no more."""
    _drawing.end()
