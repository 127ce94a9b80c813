"""The areas of Blender's windows."""

from __future__ import annotations

from collections.abc import Iterator

import bpy


def areas(*kinds: str) -> Iterator[bpy.types.Area]:
    """Every area of some kinds, in every window; of any kind without."""
    for window in bpy.context.window_manager.windows:
        yield from (area for area in window.screen.areas if not kinds or area.type in kinds)


def redraw(*kinds: str) -> None:
    """Draw the areas of some kinds again."""
    for area in areas(*kinds):
        area.tag_redraw()


def redraw_status_bar() -> None:
    """Redraw the status bar of every window, from any timer.

    No screen lists the status bar among its areas. It is redrawn where a view layer's name is said to have changed,
    which touches no window: `WorkSpace.status_text_set` does, and ends Blender 4.3 when a timer calls it after a
    file was opened.
    """
    bpy.msgbus.publish_rna(key=(bpy.types.ViewLayer, "name"))
