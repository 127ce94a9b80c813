"""The speed graph of the active object, drawn into the corner of the 3D view."""

from __future__ import annotations

import bpy
import numpy as np

from ...bridge.sampling.stepping import frame_of
from ...core.geometry import FloatArray
from ...editing.layout.speed_graph import HEIGHT, WIDTH, GraphShapes, curves, moment
from ...editing.motion.kinematics import MotionComparison
from ...registering import Drawing
from ...translations import localized
from .properties import graph_of

MARGIN = 12
LEAST_SCALE = 0.5
"""In a view that has no room for a graph of this size, none is drawn."""
FONT_SIZE = 11

_newest: list[tuple[MotionComparison, GraphShapes]] = []
"""The newest curves, and the motion that they are of: they are laid out again only when that changes."""


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn, in the region's pixels."""
    context = bpy.context
    scene = context.scene
    if not scene.unisim_motion.show_graph or not scene.unisim.log or not context.space_data.overlay.show_overlays:
        return
    graph = graph_of(context)
    right = free_width(context)
    scale = min(
        context.preferences.system.ui_scale, (right - 2 * MARGIN) / WIDTH, (context.region.height - 2 * MARGIN) / HEIGHT
    )
    if graph is None or scale < LEAST_SCALE:
        return
    if not _newest or _newest[0][0] is not graph:
        _newest[:] = [(graph, curves(graph))]
    corner = np.array([right - MARGIN - scale * WIDTH, MARGIN])
    for shapes in (_newest[0][1], moment(graph, frame_of(scene))):
        draw_shapes(shapes, corner, scale)


def free_width(context: bpy.types.Context) -> float:
    """Return where the sidebar that lies over a 3D view begins, from the view's left, in pixels."""
    region = context.region
    covers = [r.x - region.x for r in context.area.regions if r.type == "UI" and r.width > 1 and r.x > region.x]
    return float(min([region.width, *covers]))


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


DRAWINGS = (Drawing(draw, "POST_PIXEL"),)


def unregister() -> None:
    """Forget the newest graph."""
    _newest.clear()
