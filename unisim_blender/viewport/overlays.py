"""Lines drawn into the 3D view: trajectories of the selected actors, where moved sensors were recorded, and outlines of
boxes through a lens that bends lines. Blender itself draws boxes through a pinhole, which is not where the recorded and
the rendered image show things."""

from __future__ import annotations

import bpy
import numpy as np

from ..bridge.objects.imported import drive_of, imported_objects
from ..bridge.objects.sensors import camera_model_of
from ..bridge.sampling.stepping import frame_of
from ..bridge.views.trails import outline, trail
from ..bridge.window import chosen
from ..core.geometry import FloatArray, invert_pose
from ..editing.layout.speed_graph import GraphShapes
from ..editing.sampled.clock import Clock
from ..editing.sampled.scene import optical, rigid
from ..editing.sensors.lenses import bent_edges, corners
from ..registering import Drawing
from ..translations import localized
from .view_types import looks_through
from .views import camera_rectangle

MAX_DRAWN = 20
"""Objects of either kind whose trajectories or outlines are drawn at once."""
COLOUR, CHOSEN_COLOUR, ACTIVE_COLOUR = (1.0, 1.0, 1.0, 0.7), (0.95, 0.45, 0.1, 1.0), (1.0, 0.65, 0.25, 1.0)
KINDS = ("ACTOR", "BODY")
FONT_SIZE = 11


def draw_trails() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    context = bpy.context
    scene = context.scene
    if not scene.unisim.log or not context.space_data.overlay.show_overlays:
        return
    about = scene.unisim
    selected = chosen(context, "ACTOR", "EGO")[:MAX_DRAWN] if about.show_ways else []
    sensors = chosen(context, "CAMERA", "LIDAR")[:MAX_DRAWN] if about.show_sensors else []
    drive = drive_of(scene)
    if drive is None or (not selected and not sensors):
        return
    clock, frame = Clock.of(drive), frame_of(scene)
    lines = [trail(obj, drive, clock, frame) for obj in selected]
    lines += [outline(scene, obj, drive, frame) for obj in sensors]
    points = np.concatenate([line.points for line in lines]).astype(np.float32)
    colours = np.concatenate([line.colours for line in lines]).astype(np.float32)
    if not len(points):
        return
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": points, "color": colours})
    gpu.state.line_width_set(2.0)
    gpu.state.depth_test_set("NONE")
    batch.draw(shader)
    gpu.state.line_width_set(1.0)


def draw_boxes() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    context = bpy.context
    scene, space = context.scene, context.space_data
    if not scene.unisim.log or not space.overlay.show_overlays or looks_through(scene, space) != "RIG":
        return
    boxes = outlines(scene, context.view_layer)
    if not boxes:
        return
    points = np.concatenate([segments for segments, _ in boxes]).reshape(-1, 2)
    colours = np.repeat([colour for _, colour in boxes], [2 * len(segments) for segments, _ in boxes], 0)
    left, bottom, width, height = camera_rectangle(context, scene)
    model = camera_model_of(scene.camera)
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
    model = camera_model_of(scene.camera)
    if model.is_pinhole:
        return []
    camera_from_world = invert_pose(rigid(optical(np.array(scene.camera.matrix_world, float))))
    boxes = []
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
                boxes.append((segments, ACTIVE_COLOUR if active else CHOSEN_COLOUR if chosen else COLOUR))
    return boxes


def draw_shapes(shapes: GraphShapes, corner: FloatArray, scale: float) -> None:
    """Draw shapes with their lower left at a corner (2,) of the region."""
    import blf
    import gpu
    from gpu_extras.batch import batch_for_shader

    if shapes.corners:
        points = np.zeros((len(shapes.corners), 3), np.float32)
        points[:, :2] = corner + scale * np.array(shapes.corners)
        shader = gpu.shader.from_builtin("SMOOTH_COLOR")
        gpu.state.blend_set("ALPHA")
        batch_for_shader(shader, "TRIS", {"pos": points, "color": np.array(shapes.colours, np.float32)}).draw(shader)
        gpu.state.blend_set("NONE")
    blf.size(0, FONT_SIZE * scale)
    for text, x, y, colour in shapes.texts:
        blf.color(0, *colour)
        blf.position(0, corner[0] + scale * x, corner[1] + scale * y, 0)
        blf.draw(0, localized(text))


DRAWINGS = (Drawing(draw_boxes, "POST_PIXEL"), Drawing(draw_trails))
