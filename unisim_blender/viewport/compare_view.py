"""Overlay of a view that compares images: the split's line, which the mouse drags, labels and legends; and the timer
that has images flicker."""

from __future__ import annotations

from typing import Any, NamedTuple

import bpy
import numpy as np

from ..bridge.window import redraw_rendered, run_soon
from ..editing.images.comparison import DOUBT_ALPHA, tint
from ..editing.layout.overlays import Rectangle
from ..editing.texts import Text
from ..process.preparation import PREPARATION
from ..registering import Drawing
from ..translations import localized
from .comparison import FLICKER_S, IMAGES, difference_of
from .options import options_of
from .overlay_layout import GROUND, fill, ground_size, in_rows, overlay_layout, write_rows
from .views import VIEWS, ViewportImage

GRAB_PX = 8
"""Distance from the split's line within which the mouse grabs it."""
GAP_PX, HATCH_PX, GRADES_PX = 8, 20, 110
GRADES = 20
"""Number of steps of the legend of confidence."""
LINE, TEXT, HATCH = (1.0, 1.0, 1.0, 0.9), (1.0, 1.0, 1.0, 1.0), (1.0, 0.15, 0.15, 1.0)
RECORDED, RENDERED = Text("recorded"), Text("rendered")
STANDS_IN, PRELIMINARY = Text("Recorded image, not rendered"), Text("Preliminary image")
BAR, BAR_PX = (0.3, 0.6, 1.0, 1.0), 6
"""Colour and height of progress bars."""
UNSUPPORTED = Text("Unsupported: nothing recorded shows this")
CONFIDENCE = Text("Confidence from 0 to 100 %")


def drawn_view(region: bpy.types.Region) -> ViewportImage | None:
    """Return the image that the engine draws into a region; None where it draws none."""
    address = region.as_pointer()
    return next((view for view in VIEWS if view.region == address), None)


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
    if mode == "FLICKER":
        run_soon(_turn, FLICKER_S)
    image = shown_image(context, view)
    if image.width < 1 or image.height < 1:
        return
    gap, labels = GAP_PX * scale, preparation_labels(view)
    if mode == "SPLIT":
        x = line_at(context.region, options.split) or 0.0
        low, high = clear_line(context, image, x)
        fill(x - scale, low, x + scale, high, LINE)
        fill(x - 4 * scale, (low + high) / 2 - 20 * scale, x + 4 * scale, (low + high) / 2 + 20 * scale, LINE)
        for text, side in ((RECORDED, -1), (RENDERED, 1)):
            width = ground_size([localized(text)], scale)[0]
            begin = x + gap if side > 0 else x - gap - width
            if begin >= image.left and begin + width <= image.right:
                labels.append(ImageLabel(text, begin))
    elif mode != "RENDERED" and not view.stands_in:
        shown = {"FLICKER": RECORDED if view.comparison.turn else RENDERED, "RECORDED": RECORDED}
        labels.append(ImageLabel(shown.get(mode) or view.comparison.metrics or difference_of(options.gain)))
    elif options.mode != "RENDERED" and not view.problem and view.comparison.lacks:
        labels.append(ImageLabel(view.comparison.lacks))
    if options.unsupported and mode in ("RENDERED", "SPLIT", "FLICKER"):
        labels.append(ImageLabel(UNSUPPORTED, hatched=True))
    if options.confidence and mode in ("RENDERED", "SPLIT", "FLICKER"):
        labels.append(ImageLabel(CONFIDENCE, graded=True))
    _write(context, image, labels, scale)


class ImageLabel(NamedTuple):
    """A text at the lower edge of an image: from a left edge, or centred above the others; ``hatched``: with a piece of
    what it is about; ``graded``: with the colours of confidence from 0 to 1; ``fraction``: with a bar of what is done."""

    text: str
    left: float | None = None
    hatched: bool = False
    fraction: float | None = None
    graded: bool = False


def preparation_labels(view: ViewportImage) -> list[ImageLabel]:
    """Return what stands in for a view's finished image, and how far that is."""
    recorded, labels = view.stands_in and view.comparison.has_recorded, []
    if not (view.stands_in or view.preliminary):
        return []
    if PREPARATION.active or PREPARATION.stopped or PREPARATION.problem:
        labels.append(ImageLabel(PREPARATION.text, fraction=PREPARATION.fraction))
    if recorded or view.preliminary:
        labels.append(ImageLabel(STANDS_IN if recorded else PRELIMINARY))
    return labels


def shown_image(context: bpy.types.Context, view: ViewportImage) -> Rectangle:
    """Return the part of a view's image that no region covers."""
    left, bottom, width, height = view.rectangle
    free = overlay_layout(context).free
    return Rectangle(
        max(left, free.left), max(bottom, free.bottom), min(left + width, free.right), min(bottom + height, free.top)
    )


def clear_line(context: bpy.types.Context, image: Rectangle, x: float) -> tuple[float, float]:
    """Return from what to what height the split's line at a place is drawn and taken hold of: where no overlay lies."""
    low, high = overlay_layout(context).clear(x - GRAB_PX, x + GRAB_PX)
    return min(max(low, image.bottom), image.top), min(high, image.top)


def _write(context: bpy.types.Context, image: Rectangle, labels: list[ImageLabel], scale: float) -> None:
    """Write labels into an image, above the overlays there."""
    layout, gap, above, floor, beside = overlay_layout(context), GAP_PX * scale, image.bottom, image.bottom, False
    for text, left, is_hatched, fraction, graded in labels:
        floor = floor if beside and left is not None else above
        beside = left is not None
        piece = HATCH_PX * scale if is_hatched else GRADES_PX * scale if graded else 0.0
        rows = in_rows([localized(text)], image.width - piece, scale)
        width, height = ground_size(rows, scale)
        begin = (image.left + image.right - width - piece) / 2 if left is None else left
        low = max(floor, layout.clear(begin, begin + width + piece)[0]) + gap
        if fraction is not None:
            fill(begin, low, begin + width, low + BAR_PX * scale, GROUND)
            fill(begin, low, begin + fraction * width, low + BAR_PX * scale, BAR)
            low += BAR_PX * scale
        write_rows(rows, begin + piece, low + height, scale, TEXT)
        above = max(above, low + height)
        if graded:
            fill(begin, low, begin + piece, low + height, GROUND)
            step = (piece - 10 * scale) / GRADES
            for i in range(GRADES):
                r, g, b, a = tint(np.array(i / (GRADES - 1), np.float32)).tolist()
                x, colour = begin + 5 * scale + i * step, (*(c / max(a, 1e-6) for c in (r, g, b)), a / DOUBT_ALPHA)
                fill(x, low + 5 * scale, x + step, low + height - 5 * scale, colour)
        if is_hatched:
            fill(begin, low, begin + piece, low + height, GROUND)
            for i in range(3):
                x = begin + (5 + 5 * i) * scale
                fill(x, low + 5 * scale, x + 3 * scale, low + height - 5 * scale, HATCH)


class UNISIM_GT_split(bpy.types.Gizmo):
    """The line between the recorded and the rendered image"""

    bl_idname = "UNISIM_GT_split"

    def draw(self, context: bpy.types.Context) -> None:
        """Nothing: the view draws the line with its image."""

    def test_select(self, context: bpy.types.Context, location: Any) -> int:
        at, view = line_at(context.region, options_of(context.space_data).split), drawn_view(context.region)
        if at is None or view is None or abs(location[0] - at) > GRAB_PX * context.preferences.system.ui_scale:
            return -1
        low, high = clear_line(context, shown_image(context, view), at)
        return 0 if low <= location[1] <= high else -1

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        self.before = options_of(context.space_data).split
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event, tweak: set[str]) -> set[str]:
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
        return is_rendered(context) and options_of(context.space_data).mode == "SPLIT"

    def setup(self, context: bpy.types.Context) -> None:
        self.gizmos.new(UNISIM_GT_split.bl_idname).use_draw_modal = True


def draw_modes(self: bpy.types.Header, context: bpy.types.Context) -> None:
    """Draw quality and mode into the header of the views of a drive; grey where the engine does not draw the view, so
    that shading moves no button."""
    if context.scene.unisim.log:
        row = self.layout.row()
        row.enabled = is_rendered(context)
        row.prop(context.scene.unisim, "quality", text="")
        row.prop(context.window_manager.unisim_view, "mode", text="")
        view = drawn_view(next(region for region in context.area.regions if region.type == "WINDOW"))
        row = self.layout.row()
        row.enabled = view is not None and bool(view.problem) and is_rendered(context)
        button = row.operator("unisim.show_problem", text="", icon="ERROR")
        if view is not None and row.enabled:
            button.title, button.text, button.remedy = "UniSim", view.problem, view.remedy


def draw_options(layout: Any, context: bpy.types.Context) -> None:
    """Draw a view's options into a panel; those that do not apply are grey."""
    view, rendered = context.window_manager.unisim_view, is_rendered(context)
    layout.label(text="In Rendered Shading by UniSim", icon="SHADING_RENDERED")
    for name, applies in (
        ("mode", True),
        ("split", view.mode == "SPLIT"),
        ("gain", view.mode == "DIFFERENCE"),
        ("unsupported", True),
        ("confidence", True),
        ("clip", True),
    ):
        row = layout.row()
        row.enabled = rendered and applies
        row.prop(view, name)


def _turn() -> float | None:
    """Redraw the views that flicker; the clock stops when there are none."""
    flickers = redraw_rendered(lambda space: options_of(space).mode == "FLICKER")
    return FLICKER_S if flickers else None


DRAWINGS = (Drawing(draw, "POST_PIXEL"),)
TIMERS = (_turn,)
MENUS = ((bpy.types.VIEW3D_HT_header, draw_modes),)


unregister = IMAGES.close
