"""The presence timeline: who is there when, as bars over the drive's seconds, drawn over the lower part of the 3D view.

It is a gizmo there, so that it is found under the mouse before any tool, whatever tool is active. It shows the rows of
the actor list, in its order.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from ...editing.layout.timeline import Timeline, lay_out, scrolled, shapes_of, size_of
from ...registering import Drawing, Shortcut
from ...viewport.overlay_layout import WANTED, draw_shapes, measure_at, overlay_layout
from . import listing

WHEEL_ROWS = 3


def shown(context: bpy.types.Context) -> bool:
    """Return whether a 3D view draws the timeline: with its overlays and its gizmos, since it is both."""
    space, about = context.space_data, context.scene.unisim
    if space is None or space.type != "VIEW_3D" or not about.log or not about.show_timeline:
        return False
    return bool(space.overlay.show_overlays and space.show_gizmo)


def timeline_of(context: bpy.types.Context) -> Timeline | None:
    """Return the timeline of the 3D view of a context; None where it is not drawn."""
    if not shown(context):
        return None
    table = listing.table_of(context.scene)
    box = overlay_layout(context).overlays.get("timeline")
    if table.clock is None or box is None:
        return None
    scroll, scale = context.window_manager.unisim_actors.scroll, context.preferences.system.ui_scale
    times = table.clock.times_s
    return lay_out(box, scale, table.shown, scroll, float(times[0]), float(times[-1]))


def wanted_size(context: bpy.types.Context) -> tuple[float, float] | None:
    """Return the least width and the height of the timeline of a 3D view at a scale of 1; None while it is not shown."""
    return size_of(len(listing.table_of(context.scene).shown)) if shown(context) else None


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    context = bpy.context
    timeline = timeline_of(context)
    if timeline is None:
        return
    table, scale = listing.table_of(context.scene), context.preferences.system.ui_scale
    now_s = float(table.clock.time_s(np.array(context.scene.frame_current_final))) if table.clock is not None else 0.0
    active = context.view_layer.objects.active
    key = active.session_uid if active is not None and active.select_get() else None
    draw_shapes(shapes_of(timeline, now_s, key, scale, measure_at(scale)), text_scale=scale)


class UNISIM_GT_timeline(bpy.types.Gizmo):
    """The presence timeline"""

    bl_idname = "UNISIM_GT_timeline"

    __slots__ = ("frame", "timeline")

    def draw(self, context: bpy.types.Context) -> None:
        """Nothing: the timeline is drawn with the overlays."""

    def test_select(self, context: bpy.types.Context, location: Any) -> int:
        timeline = timeline_of(context)
        return 0 if timeline is not None and timeline.covers(*location) else -1

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Select the actor of the row, at the time under the mouse; beside the rows go to that time."""
        self.timeline = timeline_of(context)
        if self.timeline is None:
            return {"CANCELLED"}
        x, y = event.mouse_region_x, event.mouse_region_y
        hit = self.timeline.hit(x, y)
        if hit is None:
            go_to(context, self.timeline.time_at(x))
        else:
            bpy.ops.unisim.choose_actor("EXEC_DEFAULT", True, name=hit[0].name, seconds=hit[1])
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event, tweak: set[str]) -> set[str]:
        if event.type == "MOUSEMOVE" and self.timeline is not None and event.mouse_region_x != event.mouse_prev_x:
            if abs(event.mouse_x - event.mouse_prev_press_x) > 3:
                go_to(context, self.timeline.time_at(event.mouse_region_x))
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool) -> None:
        self.timeline = None


def go_to(context: bpy.types.Context, time_s: float) -> None:
    """Show the frame nearest to a time."""
    clock = listing.table_of(context.scene).clock
    if clock is None:
        return
    frame = int(round(float(clock.frame(np.array(time_s)))))
    if frame != context.scene.frame_current:
        context.scene.frame_set(frame)


class UNISIM_GGT_timeline(bpy.types.GizmoGroup):
    """The presence timeline in the 3D view"""

    bl_idname = "UNISIM_GGT_timeline"
    bl_label = "Presence Timeline"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT", "SCALE"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return shown(context)

    def setup(self, context: bpy.types.Context) -> None:
        gizmo = self.gizmos.new(UNISIM_GT_timeline.bl_idname)
        gizmo.use_draw_modal = True


class UNISIM_OT_scroll_timeline(bpy.types.Operator):
    """Scroll the presence timeline under the mouse"""

    bl_label = "Scroll Presence Timeline"
    bl_options = {"INTERNAL"}

    rows: bpy.props.IntProperty(name="Rows", description="Number of rows, downwards", default=WHEEL_ROWS)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return shown(context)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Scroll where the mouse is on it; elsewhere the wheel is Blender's."""
        timeline, about = timeline_of(context), context.window_manager.unisim_actors
        if timeline is None or not timeline.covers(event.mouse_region_x, event.mouse_region_y):
            return {"PASS_THROUGH"}
        about.scroll = scrolled(timeline.first, self.rows, timeline.count, len(timeline.rows))
        context.area.tag_redraw()
        return {"FINISHED"}


DRAWINGS = (Drawing(draw, "POST_PIXEL"),)
SHORTCUTS = tuple(
    Shortcut("unisim.scroll_timeline", wheel, properties={"rows": rows}, keymap="3D View", editor="VIEW_3D")
    for wheel, rows in (("WHEELUPMOUSE", -WHEEL_ROWS), ("WHEELDOWNMOUSE", WHEEL_ROWS))
)
WANTED["timeline"] = wanted_size
