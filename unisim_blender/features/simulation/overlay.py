"""A rollout drawn into the 3D view of the scene that was opened from it: the driver's plan, and the recorded drive as a
ghost."""

from __future__ import annotations

import bpy

from ...bridge.objects.imported import drive_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.views.rollouts import forget, rollout_lines
from ...editing.layout.trails import TrailSegments
from ...editing.sampled.clock import Clock
from ...registering import Drawing
from ...viewport.overlay_layout import draw_batch

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
    lines = lines_now(bpy.context.scene) if bpy.context.space_data.overlay.show_overlays else None
    if lines is not None and len(lines.points):
        draw_batch("LINES", lines.points, lines.colours, WIDTH_PX)


DRAWINGS = (Drawing(draw),)


unregister = forget
