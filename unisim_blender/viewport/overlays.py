"""Lines drawn into the 3D view: trajectories of the selected actors, where moved sensors were recorded, the direction of the
sun, and outlines of
boxes through a lens that bends lines. Blender itself draws boxes through a pinhole, which is not where the recorded and
the rendered image show things."""

from __future__ import annotations

import bpy
import numpy as np

from ..bridge.objects.imported import drive_of, imported_objects
from ..bridge.objects.meshes import size_of
from ..bridge.objects.sensors import camera_model_of
from ..bridge.sampling.stepping import frame_of
from ..bridge.views.trails import outline, trail
from ..bridge.window import chosen
from ..core.geometry import FloatArray, invert_pose
from ..core.sensors.silhouettes import bent_edges
from ..editing.layout.trails import joined, sun_lines
from ..editing.sampled.clock import Clock
from ..editing.sampled.scene import optical, rigid
from ..editing.sensors.lenses import corners
from ..registering import Drawing
from .overlay_layout import draw_batch
from .view_types import looks_through
from .views import camera_rectangle

MAX_DRAWN = 20
"""Objects of either kind whose trajectories or outlines are drawn at once."""
COLOUR, CHOSEN_COLOUR, ACTIVE_COLOUR = (1.0, 1.0, 1.0, 0.7), (0.95, 0.45, 0.1, 1.0), (1.0, 0.65, 0.25, 1.0)
KINDS = ("ACTOR", "BODY")


def draw_trails() -> None:
    """Called by Blender whenever a 3D view is drawn."""
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
    trails = [trail(obj, drive, clock, frame) for obj in selected]
    lines = joined([*trails, *(outline(scene, obj, drive, frame) for obj in sensors)])
    if len(lines.points):
        draw_batch("LINES", lines.points, lines.colours, 2.0)


def draw_sun() -> None:
    """Called by Blender whenever a 3D view is drawn: where the sun stands, from the active actor or the vehicle."""
    context = bpy.context
    scene, sun = context.scene, context.scene.unisim_sun
    if not scene.unisim.log or not context.space_data.overlay.show_overlays or not sun.enabled:
        return
    active = context.view_layer.objects.active
    obj = active if active is not None and active.unisim.kind == "ACTOR" else next(imported_objects(scene, "EGO"), None)
    if obj is not None:
        pose = rigid(np.array(obj.matrix_world, float))
        lines = sun_lines(pose, size_of(obj), np.array(sun.direction))
        draw_batch("LINES", lines.points, lines.colours, 2.0)


def draw_boxes() -> None:
    """Called by Blender whenever a 3D view is drawn."""
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
    places = [left, bottom + height] + points * [width / model.width, -height / model.height]
    draw_batch("LINES", places, colours, 1.5)


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


DRAWINGS = (Drawing(draw_boxes, "POST_PIXEL"), Drawing(draw_trails), Drawing(draw_sun))
