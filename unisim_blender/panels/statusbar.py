"""Progress of the background task, and of preparing images, in the status bar."""

from pathlib import Path

import bpy

from ..features.problems import problem_button
from ..process.background import newest, running
from ..process.packages import PackageTask
from ..process.preparation import PREPARATION
from ..translations import interface, localized, message

WIDTH = 24.0
"""In units of the interface: whose task it is, a sentence and its bar."""


def draw_progress(self: bpy.types.Header, context: bpy.types.Context) -> None:
    """Draw what runs in the background, for which file, how far it is, and how far images are prepared, each with its
    Cancel button."""
    last = max(newest.values(), key=lambda task: task.started_s, default=None)
    if last is not None and last.problem:
        problem_button(self.layout, interface(last.title), last.problem, last.remedy, interface("A task failed"))
    elif isinstance(last, PackageTask) and not last.running:
        self.layout.label(text=last.line, translate=False)
    if PREPARATION.active or PREPARATION.stopped or PREPARATION.problem:
        row = self.layout.row(align=True)
        row.ui_units_x = WIDTH
        row.progress(factor=PREPARATION.fraction, text=localized(PREPARATION.text))
        if PREPARATION.active:
            row.operator("unisim.stop_preparation", text="", icon="CANCEL")
        else:
            row.operator("unisim.resume_preparation", text="", icon="PLAY")
    if not running or not running[0].line:
        return
    task = running[0]
    row = self.layout.row(align=True)
    row.ui_units_x = WIDTH
    whose = Path(task.file).name if task.file else message("unsaved file")
    row.progress(factor=task.fraction_shown, text=f"{interface(task.title)}, {whose}: {task.line}")
    row.operator("unisim.cancel_task", text="", icon="CANCEL")


def register() -> None:
    """Add the progress to the status bar."""
    header = bpy.types.STATUSBAR_HT_header
    header.append(draw_progress)
    if hasattr(header, "_draw_orig"):  # what `WorkSpace.status_text_set` puts back would leave it out again
        header._draw_orig = header.draw


def unregister() -> None:
    """Take it away."""
    bpy.types.STATUSBAR_HT_header.remove(draw_progress)
