"""Progress of the background task, and of preparing images, in the status bar."""

import bpy

from ..process.background import running
from ..process.preparation import PREPARATION
from ..translations import localized

WIDTH = 16.0
"""In units of the interface: a sentence and its bar."""


def draw_progress(self: bpy.types.Header, context: bpy.types.Context) -> None:
    """Draw how far the background task is and how far images are prepared, each with its Cancel button."""
    manager = context.window_manager
    if PREPARATION.active or PREPARATION.stopped or PREPARATION.problem:
        row = self.layout.row(align=True)
        row.ui_units_x = WIDTH
        row.progress(factor=PREPARATION.fraction, text=localized(PREPARATION.text))
        if PREPARATION.active:
            row.operator("unisim.stop_preparation", text="", icon="CANCEL")
        else:
            row.operator("unisim.resume_preparation", text="", icon="PLAY")
    if not running or not manager.unisim_task:
        return
    row = self.layout.row(align=True)
    row.ui_units_x = WIDTH
    row.progress(factor=manager.unisim_progress, text=manager.unisim_task)
    row.operator("unisim.cancel_task", text="", icon="CANCEL")


CLASSES = ()


def register() -> None:
    """Add the progress to the status bar."""
    header = bpy.types.STATUSBAR_HT_header
    header.append(draw_progress)
    if hasattr(header, "_draw_orig"):  # what `WorkSpace.status_text_set` puts back would leave it out again
        header._draw_orig = header.draw


def unregister() -> None:
    """Take it away."""
    bpy.types.STATUSBAR_HT_header.remove(draw_progress)
