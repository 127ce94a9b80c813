"""Panel Edits: what of the drive is edited, a line for each edit."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import bpy

from ...bridge.sampling.edit_list import reading_of
from ...editing.edits.lines import EditLine
from ...editing.texts import counted, wrapped
from ...translations import interface, localized
from ..problems import draw_problem
from ..sidebar import DrivePanel
from . import watch as edit_watch

PAGE = 12
"""Edits that are shown at once."""
LEAST_WIDTH, BESIDE, BELOW = 200, 135, 95
"""The least width that texts are made to fit, and what of a width a line's text lacks: icon, margins and tabs; beside
buttons these, too."""


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
            draw_line(column, line, room_of(context))
        if pages > 1:
            row = layout.row(align=True)
            row.prop(manager, "unisim_edits_page", text=interface("Page of {count}", count=pages), translate=False)


class LineWidth(NamedTuple):
    """Width of a line's text in pixels, ``beside`` its buttons and ``below`` them, and the function that measures how
    wide a text is drawn."""

    beside: float
    below: float
    width_of: Callable[[str], float]


def room_of(context: bpy.types.Context) -> LineWidth:
    """Return the room of the region that a panel is drawn in."""
    import blf

    scale = context.preferences.system.ui_scale
    blf.size(0, context.preferences.ui_styles[0].widget.points * scale)
    width = max(context.region.width if context.region is not None else 0, LEAST_WIDTH * scale)
    return LineWidth(width - BESIDE * scale, width - BELOW * scale, lambda text: float(blf.dimensions(0, text)[0]))


def draw_line(layout: Any, line: EditLine, room: LineWidth) -> None:
    """Draw one edit: what, who and when, and its buttons; a text that is too long for its row goes on
    in the next one."""
    box = layout.box().column(align=True)
    row = box.row(align=True)
    first_row = row.row(align=True)
    first_row.alignment, first_row.active = "LEFT", line.muted < 0
    what = wrapped(
        localized(line.what), room.below if line.part == "PROBLEM" else room.beside, room.below, room.width_of
    )
    pressed(first_row.operator("unisim.go_to_edit", text=what[0], translate=False, icon=line.icon, emboss=False), line)
    going_on = box.column(align=True)
    going_on.active = line.muted < 0
    for text in what[1:]:
        going_on.label(text=text, translate=False, icon="BLANK1")
    below = box.column(align=True)
    below.active = False
    whose = line.who
    if line.part != "PROBLEM":
        whose = interface("{name}, {start:.1f} to {end:.1f} s", name=line.who, start=line.start_s, end=line.end_s)
    if line.muted >= 0:
        whose = interface("Muted: {edit}", edit=whose)
    for text in wrapped(whose, room.below, room.below, room.width_of):
        below.label(text=text, translate=False, icon="BLANK1")
    if line.part == "PROBLEM":
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
