"""LiDAR points drawn into the 3D view in colours, with their legend: Blender itself shows a mesh's vertices all alike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import gpu
import numpy as np
from bpy_extras.view3d_utils import location_3d_to_region_2d
from gpu_extras.batch import batch_for_shader
from mathutils import Vector

from ...bridge.objects.imported import imported_objects
from ...bridge.views.points import sweep_of
from ...editing.layout.point_colours import KINDS, PointColours, PointLegend, coloured, legend_shapes
from ...editing.layout.shapes import OverlayShapes
from ...editing.sensors.sweeps import DROPS, RECORDED, ViewedSweep
from ...editing.texts import Text
from ...registering import Drawing
from ...translations import localized
from ...viewport.overlay_layout import WANTED, draw_shapes, measure_at, overlay_layout, point_shader, write_rows

SIZE, BEHIND_SIZE, CAMERA_SIZE = 3.0, 2.0, 1.0
"""Of a point, of one behind a surface, an actor's box say, and of those over a camera's image, which they would hide, in
pixels of an ordinary display."""
LABEL_M, TEXT = 3.0, (1.0, 1.0, 1.0, 1.0)
"""Height above the vehicle of the words beside sweeps that are drawn apart, and their colour."""


@dataclass
class ShownPoints:
    """What is drawn of a scene's points, and what it was made of: ``key``. ``batches`` are made when they are first
    drawn."""

    key: tuple[object, ...]
    sweeps: Sequence[ViewedSweep]
    colours: Sequence[PointColours]
    legend: PointLegend
    batches: list[Any] = field(default_factory=list)


_shown: dict[str, ShownPoints] = {}
"""By scene."""


def shown_points(scene: bpy.types.Scene) -> ShownPoints | None:
    """Return what is drawn of a scene's points, made again only where something changed; None where there are none."""
    for name in set(_shown) - set(bpy.data.scenes.keys()):
        del _shown[name]
    objects = list(imported_objects(scene, "POINTS"))
    if not objects:
        _shown.pop(scene.name, None)
        return None
    key = (scene.unisim.points_colour, *((obj.name, obj.unisim.stamp) for obj in objects))
    if scene.name not in _shown or _shown[scene.name].key != key:
        sweeps = [sweep_of(obj) for obj in objects]
        _shown[scene.name] = ShownPoints(key, sweeps, *coloured(sweeps, scene.unisim.points_colour))
    return _shown[scene.name]


def offset(scene: bpy.types.Scene, kind: str) -> Vector:
    """Return the displacement of points of a kind: recorded ones to the vehicle's left where the scene has them
    beside."""
    aside = scene.unisim.recorded_offset_m if kind in (RECORDED, DROPS[RECORDED]) else 0.0
    ego = next(imported_objects(scene, "EGO"), None)
    left = ego.matrix_world.to_quaternion() @ Vector((0.0, 1.0, 0.0)) if ego is not None else Vector((0.0, 1.0, 0.0))
    return left * aside


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    context = bpy.context
    scene, space = context.scene, context.space_data
    shown = shown_points(scene) if space.overlay.show_overlays else None
    if shown is None:
        return
    if not shown.batches:
        shown.batches = [_batch(*points) for points in zip(shown.sweeps, shown.colours, strict=True)]
    drops = DROPS.values() if not scene.unisim.show_drops else ()
    drawn = [
        (offset(scene, sweep.kind), batch)
        for sweep, batch in zip(shown.sweeps, shown.batches, strict=True)
        if batch is not None and sweep.kind not in drops
    ]
    # the engine's image has no depth: over it all points are seen alike
    flat = space.shading.type == "RENDERED" and scene.render.engine == "UNISIM"
    most = CAMERA_SIZE if context.region_data.view_perspective == "CAMERA" else SIZE
    gpu.state.blend_set("ALPHA")
    for test, size in (("NONE", most),) if flat else (("GREATER", min(most, BEHIND_SIZE)), ("LESS_EQUAL", most)):
        gpu.state.depth_test_set(test)
        gpu.state.depth_mask_set(test == "LESS_EQUAL")
        gpu.state.point_size_set(size * context.preferences.system.pixel_size)
        for aside, batch in drawn:
            with gpu.matrix.push_pop():
                gpu.matrix.translate(aside)
                batch.draw(point_shader())
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")
    gpu.state.point_size_set(1.0)
    gpu.state.blend_set("NONE")


def draw_legend() -> None:
    """Called by Blender whenever a 3D view is drawn, in the region's pixels."""
    context = bpy.context
    scene, region = context.scene, context.region
    shown = shown_points(scene) if context.space_data.overlay.show_overlays else None
    if shown is None:
        return
    scale = context.preferences.system.ui_scale
    ego = next(imported_objects(scene, "EGO"), None)
    if scene.unisim.recorded_offset_m and ego is not None:
        for kind in {sweep.kind for sweep in shown.sweeps} & set(KINDS):
            place = ego.matrix_world.translation + offset(scene, kind) + Vector((0.0, 0.0, LABEL_M))
            at = location_3d_to_region_2d(region, context.space_data.region_3d, place)
            if at is not None:
                write_rows([localized(KINDS[kind])], at.x, at.y, scale, TEXT)
    box, legend = overlay_layout(context).overlays.get("legend"), shapes_of_legend(context)
    if box is not None and legend is not None:
        draw_shapes(legend[0], (box.left, box.bottom), scale)


def shapes_of_legend(context: bpy.types.Context) -> tuple[OverlayShapes, float, float] | None:
    """Return the legend's shapes, and its width and height at a scale of 1; None where no points are shown, and in the
    bird's-eye view, which is beside one that has it."""
    space = context.space_data
    follows = space.lock_object is not None and space.lock_object.unisim.kind == "EGO"
    shown = shown_points(context.scene) if space.overlay.show_overlays and not follows else None
    if shown is None:
        return None
    scale = context.preferences.system.ui_scale
    now = context.scene.frame_current
    others = {int(sweep.frame) for sweep in shown.sweeps if len(sweep.points)} - {now}
    stale = [Text("Points of frame {frame}; this is frame {now}", frame=frame, now=now) for frame in sorted(others)]
    legend = replace(shown.legend, lines=(*shown.legend.lines, *stale))
    measure = measure_at(scale)
    return legend_shapes(legend, lambda text: measure(text) / scale)


def legend_size(context: bpy.types.Context) -> tuple[float, float] | None:
    """Return the width and height of the legend; None where there is none."""
    legend = shapes_of_legend(context)
    return None if legend is None else legend[1:]


def _batch(sweep: ViewedSweep, colours: PointColours) -> Any:
    if not len(sweep.points):
        return None
    return batch_for_shader(point_shader(), "POINTS", {"pos": sweep.points.astype(np.float32), "color": colours})


WANTED["legend"] = legend_size
DRAWINGS = (Drawing(draw), Drawing(draw_legend, "POST_PIXEL"))


unregister = _shown.clear
