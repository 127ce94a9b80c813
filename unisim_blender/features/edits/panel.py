"""Panel Edits: what of the drive is edited, a line for each edit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from ...bridge.sampling.edit_list import reading_of
from ...editing.edits.lines import PARTS, EditLine
from ...editing.texts import counted
from ...translations import interface, localized
from ..problems import draw_problem, draw_rows, panel_rows
from ..sidebar import DrivePanel
from . import watch as edit_watch

PAGE = 12
"""Edits that are shown at once."""
BESIDE = 40
"""Width of a line's buttons, in pixels of an ordinary display."""


def count_text(lines: tuple[EditLine, ...]) -> str:
    """Return how many edits there are: "3 edits, 1 muted"."""
    muted = sum(1 for line in lines if line.muted >= 0)
    count = sum(1 for line in lines if line.part != "PROBLEM")
    edits = counted(count, "1 edit", "{count} edits")
    return interface("{edits}, {muted} muted", edits=edits, muted=muted) if muted else localized(edits)


class UNISIM_PT_edits(DrivePanel, bpy.types.Panel):
    """Edits of the drive"""

    bl_label = "Edits"
    bl_order = 8
    tasks = ("EDIT",)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a line for each edit; while they are read again, the old ones are grey."""
        layout, reading = self.layout, reading_of(context.scene)
        gone = any(
            line.object_name and line.muted < 0 and line.object_name not in context.scene.objects
            for line in reading.lines
        )
        if gone:
            reading.mark()
        edit_watch.want()
        if not reading.fresh:
            layout.label(text="Reading the edits…", icon="SORTTIME")
        elif reading.problem:
            column = layout.column()
            column.alert = True
            draw_problem(column, localized(reading.problem), "ERROR")
        elif not reading.lines:
            layout.label(text="None: everything is as recorded", icon="CHECKMARK")
        else:
            layout.label(text=count_text(reading.lines), translate=False, icon="GREASEPENCIL")
        if not reading.lines:
            return
        manager = context.window_manager
        pages = -(-len(reading.lines) // PAGE)
        page = min(manager.unisim_edits_page, pages) - 1
        column = layout.column(align=True)
        column.enabled = reading.fresh
        for line in reading.lines[page * PAGE : (page + 1) * PAGE]:
            draw_line(column, line)
        if pages > 1:
            row = layout.row(align=True)
            row.prop(manager, "unisim_edits_page", text=interface("Page of {count}", count=pages), translate=False)


def draw_line(layout: Any, line: EditLine, rows: Callable[..., list[str]] = panel_rows) -> None:
    """Draw one edit: what, who and when, and its buttons; a text that is too long for its row goes on
    in the next one."""
    box, fault = layout.box().column(align=True), line.part == "PROBLEM"
    row = box.row(align=True)
    first_row = row.row(align=True)
    first_row.alignment, first_row.active = "LEFT", line.muted < 0
    what = rows(localized(line.what), 0 if fault else BESIDE)
    pressed(first_row.operator("unisim.go_to_edit", text=what[0], translate=False, icon=line.icon, emboss=False), line)
    going_on = box.column(align=True)
    going_on.active = line.muted < 0
    draw_rows(going_on, what[1:], "BLANK1")
    below = box.column(align=True)
    below.active = False
    whose = line.who
    if not fault:
        whose = interface("{name}, {start:.1f} to {end:.1f} s", name=line.who, start=line.start_s, end=line.end_s)
    if line.muted >= 0:
        whose = interface("Muted: {edit}", edit=whose)
    draw_rows(below, rows(whose), "BLANK1")
    if not PARTS[line.part].carrier:
        return
    buttons = row.row(align=True)
    buttons.alignment = "RIGHT"
    counts = "CHECKBOX_DEHLT" if line.muted >= 0 else "CHECKBOX_HLT"
    pressed(buttons.operator("unisim.mute_edit", text="", icon=counts, emboss=False), line)
    pressed(buttons.operator("unisim.revert_edit", text="", icon="LOOP_BACK", emboss=False), line)


def pressed(button: Any, line: EditLine) -> None:
    """Let a button act on a line."""
    button.kind, button.name, button.part = line.key
    button.muted = line.muted
