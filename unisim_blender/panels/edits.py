"""Panel Edits: what of the drive is edited, a line for each edit."""

from __future__ import annotations

from typing import Any

import bpy

from .. import edit_watch
from ..bridge.sampling.edit_list import reading_of
from ..editing.edits.lines import Line
from ..editing.sampled.summary import counted
from .sidebar import DrivePanel

PAGE = 12
"""Edits that are shown at once."""


def count_text(lines: tuple[Line, ...]) -> str:
    """Return how many edits there are: "3 edits, 1 muted"."""
    muted = sum(1 for line in lines if line.muted >= 0)
    count = sum(1 for line in lines if line.part != "PROBLEM")
    return counted(count, "edit") + (f", {muted} muted" if muted else "")


class UNISIM_PT_edits(DrivePanel, bpy.types.Panel):
    """What of the drive is edited"""

    bl_label = "Edits"
    bl_order = 3

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a line for each edit; while they are read again, the old ones are grey."""
        layout, reading = self.layout, reading_of(context.scene)
        gone = any(line.thing and line.muted < 0 and line.thing not in context.scene.objects for line in reading.lines)
        if gone:
            reading.mark()
        edit_watch.want()
        if not reading.fresh:
            layout.label(text="Reading the edits…", icon="SORTTIME")
        elif reading.problem:
            column = layout.column()
            column.alert = True
            column.label(text=reading.problem, icon="ERROR")
        elif not reading.lines:
            layout.label(text="None: everything is as recorded", icon="CHECKMARK")
        else:
            layout.label(text=count_text(reading.lines), icon="GREASEPENCIL")
        if not reading.lines:
            return
        manager = context.window_manager
        pages = -(-len(reading.lines) // PAGE)
        page = min(manager.unisim_edits_page, pages - 1)
        column = layout.column(align=True)
        column.enabled = reading.fresh
        for line in reading.lines[page * PAGE : (page + 1) * PAGE]:
            draw_line(column, line)
        if pages > 1:
            row = layout.row(align=True)
            row.prop(manager, "unisim_edits_page", text=f"Page of {pages}, from 0")


def draw_line(layout: Any, line: Line) -> None:
    """Draw one edit: what, who and when, and its buttons."""
    box = layout.box().column(align=True)
    row = box.row(align=True)
    told = row.row(align=True)
    told.alignment, told.active = "LEFT", line.muted < 0
    pressed(told.operator("unisim.go_to_edit", text=line.what, icon=line.icon, emboss=False), line)
    below = box.row(align=True)
    below.active = False
    if line.part == "PROBLEM":
        below.label(text=line.who, icon="BLANK1")
        return
    muted = "Muted: " if line.muted >= 0 else ""
    below.label(text=f"{muted}{line.who}, {line.start_s:.1f} to {line.end_s:.1f} s", icon="BLANK1")
    buttons = row.row(align=True)
    buttons.alignment = "RIGHT"
    counts = "CHECKBOX_DEHLT" if line.muted >= 0 else "CHECKBOX_HLT"
    pressed(buttons.operator("unisim.mute_edit", text="", icon=counts, emboss=False), line)
    pressed(buttons.operator("unisim.revert_edit", text="", icon="LOOP_BACK", emboss=False), line)


def pressed(button: Any, line: Line) -> None:
    """Let a button act on a line."""
    button.kind, button.name, button.part = line.key
    button.muted = line.muted


CLASSES = (UNISIM_PT_edits,)
