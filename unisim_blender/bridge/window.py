"""Blender's windows: their areas, redrawing, the selection, and conditions of operators as sentences, so that a greyed
button says why it is grey."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import blf
import bpy

from ..editing.layout.overlays import Rectangle, free_part
from ..editing.texts import Text, counted, wrapped
from ..translations import localized, tooltip
from .objects.imported import imported_objects
from .objects.trajectories import trajectory_of

FRAME_MARGIN = 8
"""Space around the frame of a camera that fills a view, in pixels."""


def areas(*kinds: str) -> Iterator[bpy.types.Area]:
    """Yield the areas of some kinds, in all windows; of any kind without."""
    for window in bpy.context.window_manager.windows:
        yield from (area for area in window.screen.areas if not kinds or area.type in kinds)


def show_tab(area: bpy.types.Area, category: str) -> bool:
    """Open the sidebar of a 3D view on a tab; return whether it is shown. Blender knows the tabs once the sidebar has been
    drawn."""
    area.spaces.active.show_region_ui = True
    region = next(region for region in area.regions if region.type == "UI")
    try:
        region.active_panel_category = category
    except (AttributeError, TypeError):  # it has not been drawn
        area.tag_redraw()
        return False
    region.tag_redraw()
    return True


def free_rectangle(area: bpy.types.Area, region: bpy.types.Region) -> Rectangle:
    """Return what headers, toolbar and sidebar leave free of a region of a 3D view, in its pixels."""
    places = [(other, other.x - region.x, other.y - region.y) for other in area.regions]
    boxes = [(other.type, Rectangle(x, y, x + other.width, y + other.height)) for other, x, y in places]
    return free_part(region.width, region.height, boxes)


def fit_camera_view(area: bpy.types.Area) -> None:
    """Make the camera's frame as large as what headers, toolbar and sidebar leave free of a 3D view."""
    scene, looks = bpy.context.scene, area.spaces.active.region_3d
    window = next(region for region in area.regions if region.type == "WINDOW")
    free = free_rectangle(area, window)
    render = scene.render
    wide, high = render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y
    frame = min((free.width - 2 * FRAME_MARGIN) / wide, (free.height - 2 * FRAME_MARGIN) / high)
    fit = scene.camera.data.sensor_fit
    drawn, whole = (high, window.height) if fit == "VERTICAL" else (wide, window.width)
    if fit == "AUTO":
        drawn, whole = max(wide, high), max(window.width, window.height)
    scale = max(frame * drawn / whole, 0.01)
    looks.view_camera_zoom = 50 * (2 * math.sqrt(scale) - math.sqrt(2))
    middle = (free.left + free.right - window.width) / 2, (free.bottom + free.top - window.height) / 2
    looks.view_camera_offset = [
        -apart / (2 * scale * size) for apart, size in zip(middle, (window.width, window.height), strict=True)
    ]


def redraw(*kinds: str) -> None:
    """Draw the areas of some kinds again."""
    for area in areas(*kinds):
        area.tag_redraw()


def run_soon(timer: Callable[[], float | None], after_s: float = 0.0, persistent: bool = False) -> None:
    """Have a timer of Blender's call a function, unless it does already; without a window nobody looks at what it does."""
    if not bpy.app.background and not bpy.app.timers.is_registered(timer):
        bpy.app.timers.register(timer, first_interval=after_s, persistent=persistent)


def redraw_rendered(wanted: Callable[[Any], bool] = lambda space: True) -> bool:
    """Draw the wanted views in Rendered shading again, by their spaces, without their panels; return whether there are
    any."""
    views = [area for area in areas("VIEW_3D") if area.spaces.active.shading.type == "RENDERED"]
    regions = [region for area in views if wanted(area.spaces.active) for region in area.regions]
    for region in regions:
        if region.type == "WINDOW":
            region.tag_redraw()
    return bool(regions)


def redraw_status_bar() -> None:
    """Redraw the status bar of every window, from any timer.

    No screen lists the status bar among its areas. It is redrawn where a view layer's name is said to have changed,
    which touches no window: `WorkSpace.status_text_set` does, and ends Blender 4.3 when a timer calls it after a
    file was opened.
    """
    bpy.msgbus.publish_rna(key=(bpy.types.ViewLayer, "name"))


def label_rows(text: str, width: float, first: float = 0.0) -> list[str]:
    """Return a text in rows of labels no wider than ``width``, the first than ``first`` where that is not 0, in pixels of an
    ordinary display."""
    blf.size(0, bpy.context.preferences.ui_styles[0].widget.points)
    return wrapped(text, first or width, width, lambda part: float(blf.dimensions(0, part)[0]))


def refresh(changed: Iterable[bpy.types.Object]) -> None:
    """Evaluate objects again whose keys were written, and draw all windows again.

    Writing keys by `foreach_set` tells Blender nothing: without this a box stays where it was until
    another frame is shown.
    """
    for obj in changed:
        for target in (trajectory_of(obj), obj):
            if target is None:
                continue
            action = target.animation_data.action if target.animation_data is not None else None
            if action is not None:
                action.update_tag()
            target.update_tag(refresh={"OBJECT", "TIME"})
    bpy.context.view_layer.update()
    if not bpy.app.background:
        for area in areas():
            area.tag_redraw()


def chosen(context: bpy.types.Context, *kinds: str) -> list[bpy.types.Object]:
    """Return the selected objects of some kinds."""
    return [obj for obj in context.selected_objects if obj.unisim.kind in kinds]


def counted_names(objects: list[bpy.types.Object]) -> str:
    """Return the name of the only one of some actors, or how many there are: "3 actors"."""
    return objects[0].name if len(objects) == 1 else counted(len(objects), "1 actor", "{count} actors")


def choose(context: bpy.types.Context, *objects: bpy.types.Object) -> None:
    """Select these and nothing else, also in views that do not show what was selected; the last becomes active."""
    for other in list(context.view_layer.objects.selected):
        other.select_set(False)
    for obj in objects:
        obj.select_set(True)
        context.view_layer.objects.active = obj


Need = tuple[object, str]
"""Whether a need is met, and the sentence that says what to do where it is not."""


def allowed(operator: Any, *needs: Need) -> bool:
    """Return whether all needs are met; the first that is not is what the button's tooltip says."""
    for met, sentence in needs:
        if not met:
            operator.poll_message_set(localized(sentence) if isinstance(sentence, Text) else tooltip(sentence))
            return False
    return True


def folder_on_disk(stated: str) -> Path | None:
    """Return the folder that a setting states, absolute; None where it states none, or one beside a .blend that was
    never saved."""
    if not stated or (stated.startswith("//") and not bpy.data.filepath):
        return None
    return Path(bpy.path.abspath(stated)).absolute()


def drive(context: bpy.types.Context) -> Need:
    """A drive has been imported."""
    return context.scene.unisim.log, "Import a driving log or a trained scene first"


def object_mode(context: bpy.types.Context) -> Need:
    """The window is in Object Mode."""
    return context.mode == "OBJECT", "Switch to Object Mode first (Tab)"


def vehicle(context: bpy.types.Context) -> Need:
    """The ego vehicle is there."""
    return next(imported_objects(context.scene, "EGO"), None), "Import a drive first: there is no ego vehicle"


def selected(sentence: str, *kinds: str) -> Callable[[bpy.types.Context], Need]:
    """Return the need that something of some kinds is selected."""
    return lambda context: (chosen(context, *kinds), sentence)
