"""The points in the active box from three sides, drawn over the lower left of the 3D view: from above, from its left, and
from behind."""

from __future__ import annotations

import queue
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np
from bpy.app.handlers import persistent
from numpy.typing import NDArray

from ...bridge.importing.tracks import path_of, pose_now, size_now
from ...bridge.objects.imported import source_of
from ...bridge.objects.trajectories import trajectory_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.window import redraw, run_soon
from ...core.errors import UnisimError
from ...core.geometry import FloatArray, invert_pose
from ...editing.layout.shapes import OverlayShapes
from ...editing.sampled.clock import Clock
from ...editing.texts import translatable
from ...preferences import interpreter
from ...process.client import Client, Request, client
from ...registering import Drawing
from ...translations import interface
from ...viewport.overlay_layout import draw_batch, draw_shapes, fill, overlay_layout

SIDE_PX, GAP_PX, TITLE_PX = 170.0, 6.0, 16.0
AROUND_M = 1.2
"""Distance around the box that is shown."""
POLL_S, ASK_S = 0.05, 0.15
GROUND, LINE, FRONT = (0.03, 0.03, 0.03, 0.85), (1.0, 1.0, 1.0, 0.9), (1.0, 0.55, 0.1, 1.0)
INSIDE, OUTSIDE = (0.25, 0.95, 0.45, 1.0), (0.6, 0.6, 0.6, 0.8)
SIDES = ((translatable("Above"), 0, 1), (translatable("Left Side"), 0, 2), (translatable("Behind"), 1, 2))
"""Names, and the axes to the right and up."""


@dataclass
class Shown:
    """Points (N, 3) in the frame ``base`` (4, 4) of a box's trajectory at a frame; ``key`` says of which."""

    key: tuple[Any, ...] = ("", "")
    base: FloatArray = field(default_factory=lambda: np.eye(4))
    points: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    waiting: tuple[Client, Request, tuple[Any, ...], FloatArray] | None = None


shown = Shown()


def active_box(context: bpy.types.Context) -> bpy.types.Object | None:
    """Return the active box, where its points are to be shown."""
    obj = context.view_layer.objects.active
    wanted = obj is not None and obj.unisim.kind == "TRACK" and context.scene.unisim_tracks.show_sides
    return obj if wanted else None


def ask_points() -> None:
    """Ask for the points about the active box at the frame that is shown, unless they are there; as a timer of Blender's."""
    obj, scene = active_box(bpy.context), bpy.context.scene
    if obj is None or bpy.app.is_job_running("RENDER"):
        return
    above = trajectory_of(obj)
    base = pose_now(obj) if above is None else np.array(above.matrix_world, float)
    place = tuple(np.round(base[:3, 3] / 0.5).tolist()) if above is None else ()
    key = (scene.name, obj.unisim.uid, scene.frame_current, obj.unisim_track.drawn[:400], place)
    if shown.key == key or (shown.waiting is not None and shown.waiting[2] == key):
        return
    try:
        source = source_of(scene)
    except (UnisimError, OSError):
        return
    clock = Clock.of(source.drive)
    time_s = float(clock.time_s(np.array(float(frame_of(scene)))))
    path = path_of(obj, clock, displaced=False)
    if shown.waiting is not None:
        shown.waiting[0].cancel(shown.waiting[1])
    worker = client(interpreter())
    values = {"log": str(source.log_path), "size_m": size_now(obj).tolist(), "time_s": time_s}
    poses = path.poses.reshape(-1, 16).tolist()
    shown.waiting = worker, worker.ask("box_points", **values, times_s=path.times_s.tolist(), poses=poses), key, base
    run_soon(gather, POLL_S)


def gather() -> float | None:
    """Take the points that have come; as a timer of Blender's, until they have."""
    if shown.waiting is None:
        return None
    worker, request, key, base = shown.waiting
    try:
        event = request.events.get_nowait()
    except queue.Empty:
        return POLL_S
    if event["event"] == "arrays":
        shown.key, shown.base, shown.points = key, base, worker.arrays(event)["points"]
        redraw("VIEW_3D")
        return POLL_S
    shown.waiting = None
    if event["event"] == "error":
        shown.key = key  # the same request fails again
        bpy.context.window_manager.unisim_following = event["text"]
    return None


@persistent
def follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Something changed: have a timer ask for the points about the active box."""
    if scene.unisim.log and scene.unisim_tracks.show_sides:
        run_soon(ask_points, ASK_S)


def points_in(obj: bpy.types.Object) -> tuple[FloatArray, FloatArray]:
    """Return the points (N, 3) in a box's frame where it is now, and its size (3,)."""
    above = trajectory_of(obj)
    base = shown.base if above is None else np.array(above.matrix_world, float)
    box = invert_pose(pose_now(obj)) @ base
    return shown.points @ box[:3, :3].T + box[:3, 3], size_now(obj)


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn, in the region's pixels."""
    context = bpy.context
    obj = active_box(context) if context.space_data.overlay.show_overlays else None
    if obj is None or shown.key[:2] != (context.scene.name, obj.unisim.uid):
        return
    points, size = points_in(obj)
    scale = context.preferences.system.ui_scale
    layout = overlay_layout(context)
    side, gap = SIDE_PX * scale, GAP_PX * scale
    width = 3 * side + 4 * gap
    left = layout.free.left + gap
    if width > layout.free.width:
        return
    low, high = layout.clear(left, left + width)
    bottom = low + 2 * gap
    if bottom + side + TITLE_PX * scale > high:
        return
    inside = (np.abs(points) <= size / 2).all(1)
    for number, (title, right, up) in enumerate(SIDES):
        corner, shapes = np.array([left + number * (side + gap), bottom]), OverlayShapes()
        fill(corner[0], corner[1], corner[0] + side, corner[1] + side + TITLE_PX * scale, GROUND)
        pixels = SIDE_PX / (max(size[right], size[up]) + 2 * AROUND_M)
        flip = np.array([-1.0 if (right, up) == (1, 2) else 1.0, 1.0])  # from behind, the left is at the left
        flat = SIDE_PX / 2 + pixels * flip * points[:, [right, up]]
        there = ((flat > 0) & (flat < SIDE_PX)).all(1)
        places = np.pad(corner + scale * flat[there], ((0, 0), (0, 1)))
        draw_batch("POINTS", places, np.where(inside[there, None], INSIDE, OUTSIDE), 2.0 * scale)
        ring = SIDE_PX / 2 + pixels * size[[right, up]] / 2 * [[-1, -1], [1, -1], [1, 1], [-1, 1], [-1, -1]]
        shapes.line(ring, 1.5, [LINE, FRONT if right == 0 else LINE, LINE, LINE])
        shapes.texts.append((interface(title), 4.0, SIDE_PX + 3.0, LINE))
        draw_shapes(shapes, corner, scale)


HANDLERS = (("frame_change_post", follow), ("depsgraph_update_post", follow))
DRAWINGS = (Drawing(draw, "POST_PIXEL"),)
TIMERS = (ask_points, gather)


def unregister() -> None:
    """Forget what was asked for."""
    shown.waiting = None
    shown.key = ("", "")
