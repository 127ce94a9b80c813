"""A rollout drawn into the 3D view of the scene that was opened from it: the driver's plan, and the recorded drive as a
ghost."""

from __future__ import annotations

import bpy
import numpy as np

from ...bridge.objects.imported import drive_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.views.rollouts import forget, rollout_lines
from ...editing.layout.trails import TrailSegments
from ...editing.sampled.clock import Clock
from ...registering import Drawing

WIDTH_PX = 2.0


def lines_now(scene: bpy.types.Scene) -> TrailSegments | None:
    """Return what is drawn at a scene's frame; None for a scene that is no rollout's, or whose drive cannot be read."""
    about = scene.unisim_simulation
    if not scene.unisim.log or not about.rollout or not (about.show_plans or about.show_ghost):
        return None
    drive = drive_of(scene)
    return None if drive is None else rollout_lines(scene, drive, Clock.of(drive), frame_of(scene))


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    context = bpy.context
    if not context.space_data.overlay.show_overlays:
        return
    lines = lines_now(context.scene)
    if lines is None or not len(lines.points):
        return
    shader = gpu.shader.from_builtin("SMOOTH_COLOR")
    points, colours = lines.points.astype(np.float32), lines.colours.astype(np.float32)
    batch = batch_for_shader(shader, "LINES", {"pos": points, "color": colours})
    gpu.state.line_width_set(WIDTH_PX)
    gpu.state.depth_test_set("NONE")
    gpu.state.blend_set("ALPHA")
    batch.draw(shader)
    gpu.state.blend_set("NONE")
    gpu.state.line_width_set(1.0)


DRAWINGS = (Drawing(draw),)


unregister = forget
