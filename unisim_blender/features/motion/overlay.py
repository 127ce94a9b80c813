"""The speed graph of the active object, drawn into the corner of the 3D view, where its curve can be dragged."""

from __future__ import annotations

from typing import NamedTuple

import bpy
import numpy as np

from ...bridge.sampling.stepping import frame_of
from ...core.geometry import FloatArray
from ...editing.layout.shapes import OverlayShapes
from ...editing.layout.speed_graph import HEIGHT, WIDTH, curves, grip, moment, on_curve
from ...editing.motion.kinematics import MotionComparison
from ...registering import Drawing
from ...viewport.overlay_layout import WANTED, draw_shapes, overlay_layout
from .properties import graph_of

_newest: list[tuple[tuple[MotionComparison, float], OverlayShapes]] = []
"""The newest curves, and the motion that they are of: they are laid out again only when that changes."""


class Grip(NamedTuple):
    """Where a curve is dragged: time and reach in seconds, the limit of acceleration, the speed that the axis holds, and
    the one that it is dragged to."""

    time_s: float
    reach_s: float = 0.0
    limit_m_s2: float = 0.0
    top_m_s: float = 0.0
    speed_m_s: float | None = None


grips: dict[str, Grip] = {}
"""Where the curve is dragged now, and where the mouse is on it: "drag" and "hover"."""


class GraphPlace(NamedTuple):
    """A graph in a 3D view: its lower left corner (2,) in pixels of the region, and its scale."""

    graph: MotionComparison
    corner: FloatArray
    scale: float

    def time_at(self, x: float, y: float, near: float) -> float | None:
        """Return the time at which the curve passes a place of the region; None where it does not."""
        x, y = (np.array([x, y]) - self.corner) / self.scale
        return on_curve(self.graph, float(x), float(y), near / self.scale)


def graph_place(context: bpy.types.Context) -> GraphPlace | None:
    """Return where a 3D view draws the graph; None where it does not."""
    graph, layout = shown_graph(context), overlay_layout(context)
    box = layout.overlays.get("graph")
    if graph is None or box is None:
        return None
    return GraphPlace(graph, np.array([box.left, box.bottom]), layout.graph_scale)


def shown_graph(context: bpy.types.Context) -> MotionComparison | None:
    """Return the motion whose graph a 3D view shows; None where it shows none."""
    scene = context.scene
    if not scene.unisim_motion.show_graph or not scene.unisim.log or not context.space_data.overlay.show_overlays:
        return None
    return graph_of(context)


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn, in the region's pixels."""
    place = graph_place(bpy.context)
    if place is None:
        return
    graph, corner, scale = place
    held = grips.get("drag", grips.get("hover"))
    top_m_s = held.top_m_s if held is not None else 0.0
    if not _newest or _newest[0][0][0] is not graph or _newest[0][0][1] != top_m_s:
        _newest[:] = [((graph, top_m_s), curves(graph, top_m_s))]
    for shapes in (_newest[0][1], moment(graph, frame_of(bpy.context.scene), top_m_s)):
        draw_shapes(shapes, corner, scale)
    if held is not None:
        draw_shapes(grip(graph, *held), corner, scale)


WANTED["graph"] = lambda context: None if shown_graph(context) is None else (WIDTH, HEIGHT)
DRAWINGS = (Drawing(draw, "POST_PIXEL"),)


def unregister() -> None:
    """Forget the newest graph."""
    _newest.clear()
    grips.clear()
