"""Trajectories of the selected actors, and where moved sensors were recorded, drawn into the 3D view."""

from __future__ import annotations

import bpy
import numpy as np

from ..bridge.objects.source import source_of
from ..bridge.sampling.stepping import frame_of
from ..bridge.views.trails import outline, trail
from ..bridge.window.selection import chosen
from ..core.errors import UnisimError
from ..editing.sampled.clock import Clock
from ..registering import Drawing

MOST = 20
"""Objects of either kind that are drawn at once."""


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    import gpu
    from gpu_extras.batch import batch_for_shader

    context = bpy.context
    scene = context.scene
    if not scene.unisim.log or not context.space_data.overlay.show_overlays:
        return
    about = scene.unisim
    selected = chosen(context, "ACTOR", "EGO")[:MOST] if about.show_ways else []
    sensors = chosen(context, "CAMERA", "LIDAR")[:MOST] if about.show_sensors else []
    if not selected and not sensors:
        return
    try:
        drive = source_of(scene).drive
    except (UnisimError, OSError):
        return  # the panel says so
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


_drawing = Drawing(draw)


def register() -> None:
    """Draw from now on."""
    _drawing.begin()


def unregister() -> None:
    """Draw no more."""
    _drawing.end()
