"""Overlay of a view that compares images: the split's line, which the mouse drags, labels and legends; and the timer
that has images flicker."""

from __future__ import annotations

import sys
from typing import Any

import blf
import bpy

from ..bridge.window import areas
from ..editing.texts import Text
from ..process.preparation import PREPARATION
from ..registering import Drawing, add, take_away
from ..translations import localized
from .comparison import FLICKER_S, IMAGES, difference_of
from .options import options_of

GRAB_PX = 8
"""Distance from the split's line within which the mouse grabs it."""
TEXT_PX, GAP_PX = 13, 8
LINE, TEXT, SHADE, HATCH = (1.0, 1.0, 1.0, 0.9), (1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 0.55), (1.0, 0.15, 0.15, 1.0)
RECORDED, RENDERED = Text("recorded"), Text("rendered")
STANDS_IN, PRELIMINARY = Text("Recorded image, not rendered"), Text("Preliminary image")
BAR, BAR_PX = (0.3, 0.6, 1.0, 1.0), (320, 6)
"""Colour, and width and height, of progress bars."""
UNSUPPORTED = Text("Unsupported: nothing recorded shows this")


def drawn_view(region: bpy.types.Region) -> Any:
    """Return the image that the engine draws into a region; None where it draws none."""
    viewport = sys.modules.get(f"{__package__}.views")
    address = region.as_pointer()
    views = viewport.VIEWS if viewport is not None else ()
    return next((view for view in views if view.region == address), None)


def is_rendered(context: bpy.types.Context) -> bool:
    """Return whether the engine UniSim draws a context's 3D view."""
    space = context.space_data
    if not isinstance(space, bpy.types.SpaceView3D) or space.shading.type != "RENDERED":
        return False
    return bool(context.scene.render.engine == "UNISIM" and context.scene.unisim.log)


def line_at(region: bpy.types.Region, split: float) -> float | None:
    """Return where the split's line is, in pixels from a region's left edge; None where no split is drawn there."""
    view = drawn_view(region)
    if view is None or view.comparison.mode != "SPLIT":
        return None
    left, _, width, _ = view.rectangle
    return float(left + round(split * width))


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    context = bpy.context
    view = drawn_view(context.region) if is_rendered(context) else None
    if view is None:
        return
    scale = context.preferences.system.ui_scale
    mode, options = view.comparison.mode, options_of(context.space_data)
    left, bottom, width, height = view.rectangle
    right, top = min(left + width, context.region.width), min(bottom + height, context.region.height)
    left, low = max(left, 0), max(bottom, 0)
    if mode == "FLICKER" and not bpy.app.timers.is_registered(_turn):
        bpy.app.timers.register(_turn, first_interval=FLICKER_S)
    at_y = low + GAP_PX * scale
    if view.stands_in or view.preliminary:
        at_y = _preparation(view, (left + right) / 2, at_y, scale)
    if mode == "SPLIT":
        x = line_at(context.region, options.split) or 0.0
        _rectangle(x - scale, low, x + scale, top, LINE)
        _rectangle(x - 4 * scale, (low + top) / 2 - 20 * scale, x + 4 * scale, (low + top) / 2 + 20 * scale, LINE)
        _label(RECORDED, x - GAP_PX * scale, at_y, scale, from_right=True)
        _label(RENDERED, x + GAP_PX * scale, at_y, scale)
    elif mode != "RENDERED" and not view.stands_in:
        shown = {"FLICKER": RECORDED if view.comparison.turn else RENDERED, "RECORDED": RECORDED}
        text = shown.get(mode) or view.comparison.metrics or difference_of(options.gain)
        _label(text, (left + right) / 2, at_y, scale, centred=True)
    elif options.mode != "RENDERED" and not view.problem:
        _label(view.comparison.lacks, (left + right) / 2, at_y, scale, centred=True)
    if options.unsupported and mode in ("RENDERED", "SPLIT", "FLICKER"):
        labelled = mode != "RENDERED" or options.mode != "RENDERED"
        _legend((left + right) / 2, at_y + (2 * TEXT_PX * scale if labelled else 0.0), scale)


def _preparation(view: Any, x: float, y: float, scale: float) -> float:
    """Draw what stands in for the finished image, and how far that is, with the middle at x; return where it ends."""
    recorded = view.stands_in and not view.comparison.lacks
    line = TEXT_PX * scale + 2 * GAP_PX * scale
    if PREPARATION.active or PREPARATION.stopped or PREPARATION.problem:
        half, height = BAR_PX[0] * scale / 2, BAR_PX[1] * scale
        _rectangle(x - half, y, x + half, y + height, SHADE)
        _rectangle(x - half, y, x - half + 2 * half * PREPARATION.fraction, y + height, BAR)
        y += height + GAP_PX * scale
        _label(PREPARATION.text, x, y, scale, centred=True)
        y += line
    if recorded or view.preliminary:
        _label(STANDS_IN if recorded else PRELIMINARY, x, y, scale, centred=True)
        y += line
    return y


def _legend(x: float, y: float, scale: float) -> None:
    """Say what hatching means, with the middle at x."""
    size, gap = TEXT_PX * scale, GAP_PX * scale
    blf.size(0, size)
    begin = x - (blf.dimensions(0, localized(UNSUPPORTED))[0] + size + gap) / 2
    _rectangle(begin - gap, y - 4 * scale, begin + size + gap, y + size + 2 * scale, SHADE)
    for i in range(3):
        _rectangle(begin + (i + 0.15) * size / 3, y, begin + (i + 0.65) * size / 3, y + size, HATCH)
    _label(UNSUPPORTED, begin + size + gap, y, scale)


def _rectangle(x0: float, y0: float, x1: float, y1: float, colour: tuple[float, ...]) -> None:
    import gpu
    from gpu_extras.batch import batch_for_shader

    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    batch = batch_for_shader(shader, "TRI_STRIP", {"pos": ((x0, y0), (x1, y0), (x0, y1), (x1, y1))})
    gpu.state.blend_set("ALPHA")
    shader.uniform_float("color", colour)
    batch.draw(shader)
    gpu.state.blend_set("NONE")


def _label(text: str, x: float, y: float, scale: float, from_right: bool = False, centred: bool = False) -> None:
    """Write on a dark ground that begins at (x, y), ends there, or has its middle there."""
    text = localized(text)
    blf.size(0, TEXT_PX * scale)
    width, height = blf.dimensions(0, text)
    x -= width if from_right else width / 2 if centred else 0.0
    pad = 4 * scale
    _rectangle(x - pad, y - pad, x + width + pad, y + height + pad, SHADE)
    blf.color(0, *TEXT)
    blf.position(0, x, y, 0)
    blf.draw(0, text)


class UNISIM_GT_split(bpy.types.Gizmo):
    """The line between the recorded and the rendered image"""

    bl_idname = "UNISIM_GT_split"

    def draw(self, context: bpy.types.Context) -> None:
        """Nothing: the view draws the line with its image."""

    def test_select(self, context: bpy.types.Context, location: Any) -> int:
        """Return 0 where the mouse is on the line, -1 elsewhere."""
        at = line_at(context.region, options_of(context.space_data).split)
        near = at is not None and abs(location[0] - at) <= GRAB_PX * context.preferences.system.ui_scale
        return 0 if near else -1

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Take hold of the line."""
        self.before = options_of(context.space_data).split
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event, tweak: set[str]) -> set[str]:
        """Put the line where the mouse is."""
        view = drawn_view(context.region)
        if view is not None:
            left, _, width, _ = view.rectangle
            options_of(context.space_data).split = min(1.0, max(0.0, (event.mouse_region_x - left) / max(1, width)))
            context.area.tag_redraw()
        return {"RUNNING_MODAL"}

    def exit(self, context: bpy.types.Context, cancel: bool) -> None:
        """Let it go; Esc puts it back."""
        if cancel:
            options_of(context.space_data).split = self.before
            context.area.tag_redraw()


class UNISIM_GGT_split(bpy.types.GizmoGroup):
    """Takes hold of the line between the recorded and the rendered image"""

    bl_idname = "UNISIM_GGT_split"
    bl_label = "Recorded and Rendered"
    bl_space_type = "VIEW_3D"
    bl_region_type = "WINDOW"
    bl_options = {"PERSISTENT", "SHOW_MODAL_ALL"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A split has to be shown."""
        return is_rendered(context) and options_of(context.space_data).mode == "SPLIT"

    def setup(self, context: bpy.types.Context) -> None:
        """Add the one gizmo."""
        self.gizmos.new(UNISIM_GT_split.bl_idname).use_draw_modal = True


def draw_modes(self: bpy.types.Header, context: bpy.types.Context) -> None:
    """Draw quality and mode into the header of the views of a drive; grey where the engine does not draw the view, so
    that shading moves no button."""
    if context.scene.unisim.log:
        row = self.layout.row()
        row.enabled = is_rendered(context)
        row.prop(context.scene.unisim, "quality", text="")
        row.prop(context.window_manager.unisim_view, "mode", text="")


def draw_options(layout: Any, context: bpy.types.Context) -> None:
    """Draw a view's options into a panel; those that do not apply are grey."""
    view, rendered = context.window_manager.unisim_view, is_rendered(context)
    layout.label(text="In Rendered Shading by UniSim", icon="SHADING_RENDERED")
    for name, applies in (
        ("mode", True),
        ("split", view.mode == "SPLIT"),
        ("gain", view.mode == "DIFFERENCE"),
        ("unsupported", True),
        ("clip", True),
    ):
        row = layout.row()
        row.enabled = rendered and applies
        row.prop(view, name)


def _turn() -> float | None:
    """Redraw the views that flicker; the clock stops when there are none."""
    flickers = False
    for area in areas("VIEW_3D"):
        space = area.spaces.active
        if space.shading.type != "RENDERED" or options_of(space).mode != "FLICKER":
            continue
        flickers = True
        for region in area.regions:
            if region.type == "WINDOW":
                region.tag_redraw()
    return FLICKER_S if flickers else None


CLASSES = (UNISIM_GT_split, UNISIM_GGT_split)
DRAWINGS = (Drawing(draw, "POST_PIXEL"),)
TIMERS = (_turn,)


def register() -> None:
    """Add the gizmo and the choice in the view's header."""
    add(CLASSES)
    bpy.types.VIEW3D_HT_header.append(draw_modes)


def unregister() -> None:
    """Take them away, and forget the recorded images."""
    bpy.types.VIEW3D_HT_header.remove(draw_modes)
    take_away(CLASSES)
    IMAGES.close()
