"""The speed graph of the active object, drawn into the corner of the 3D view."""

from __future__ import annotations

import bpy
import numpy as np

from ...bridge.sampling.stepping import frame_of
from ...editing.layout.speed_graph import HEIGHT, WIDTH, GraphShapes, curves, moment
from ...editing.motion.kinematics import MotionComparison
from ...registering import Drawing
from ...viewport.overlays import draw_shapes
from .properties import graph_of

MARGIN = 12
LEAST_SCALE = 0.5
"""In a view that has no room for a graph of this size, none is drawn."""

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


DRAWINGS = (Drawing(draw, "POST_PIXEL"),)


def unregister() -> None:
    """Forget the newest graph."""
    _newest.clear()
