"""Panel Variants: the scenarios of this drive in this file, and what two of them differ in."""

from __future__ import annotations

from typing import Any

import bpy

from ...bridge.changes.variants import variants_of
from ...bridge.sampling.edit_list import reading_of
from ...editing.edits.variants import Difference, compared
from ...translations import interface, localized
from ..edits import watch as edit_watch
from ..edits.panel import count_text, pressed
from ..problems import draw_problem, panel_rows
from ..sidebar import DrivePanel, draw_task
from .operators import VariantsTask

MOST = 30
"""Differences that are shown at once."""


class UNISIM_PT_variants(DrivePanel, bpy.types.Panel):
    """Scenarios of this drive in this file"""

    bl_label = "Variants"
    bl_order = 4
    tasks = ("EDIT", "RENDER")
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, shown, manager = self.layout, context.scene, context.window_manager
        edit_watch.want()
        scenes = variants_of(shown)
        column = layout.column(align=True)
        for scene in scenes:
            draw_variant(column, scene, scene == shown, manager.unisim_compared == scene.name)
        other = bpy.data.scenes.get(manager.unisim_compared)
        if other is not None and other != shown and other in scenes:
            draw_comparison(layout, shown, other)
        row = layout.row(align=True)
        row.operator("unisim.new_variant", text="New", icon="ADD")
        row.operator("unisim.rename_variant", text="Rename", icon="GREASEPENCIL")
        row.operator("unisim.delete_variant", text="", icon="TRASH")
        column = layout.column(align=True)
        column.operator("unisim.render_variants", icon="RENDER_ANIMATION")
        column.operator("unisim.export_variants", icon="EXPORT")
        draw_task(layout, shown, VariantsTask)


def draw_variant(layout: Any, scene: bpy.types.Scene, shown: bool, compared: bool) -> None:
    """Draw one variant: its name, how many edits it has, and its buttons."""
    reading = reading_of(scene)
    row = layout.row(align=True)
    icon = "RADIOBUT_ON" if shown else "RADIOBUT_OFF"
    row.operator("unisim.show_variant", text=scene.name, icon=icon, depress=shown).name = scene.name
    edits = row.row(align=True)
    edits.alignment, edits.active = "RIGHT", False
    edits.label(text=count_text(reading.lines) if reading.fresh and not reading.problem else "…", translate=False)
    beside = row.row(align=True)
    beside.enabled = not shown
    button = beside.operator("unisim.compare_variant", text="", icon="ARROW_LEFTRIGHT", depress=compared and not shown)
    button.name = scene.name
    row.prop(scene.unisim_edits, "rendered", text="", icon="RENDER_ANIMATION")


def draw_comparison(layout: Any, shown: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Draw what the variant that is shown and another one differ in."""
    here, there = reading_of(shown), reading_of(other)
    head = layout.row(align=True)
    text = interface("{name} beside {other}", name=shown.name, other=other.name)
    head.label(text=text, translate=False, icon="ARROW_LEFTRIGHT")
    head.operator("unisim.compare_variant", text="", icon="X", emboss=False).name = other.name
    if not here.fresh or not there.fresh:
        layout.label(text="Reading the edits…", icon="SORTTIME")
        return
    if here.problem or there.problem:
        draw_problem(layout, localized(here.problem or there.problem), "ERROR")
        return
    differing = compared(here.lines, there.lines)
    column = layout.column(align=True)
    if not differing:
        column.label(text="The same edits", icon="CHECKMARK")
    for item in differing[:MOST]:
        draw_difference(column.box().column(align=True), item, shown.name, other.name)
    if len(differing) > MOST:
        column.label(text=interface("and {count} more", count=len(differing) - MOST), translate=False)


def draw_difference(layout: Any, difference: Difference, here: str, there: str) -> None:
    """Draw one difference: whose it is, then the edit in each of the two."""
    who, name = difference.line.who, here if difference.here else there
    both = difference.here is not None and difference.there is not None
    what = interface("Changed: {who}", who=who) if both else interface("Only in {name}: {who}", name=name, who=who)
    head = layout.row()
    head.active = False
    head.label(text=what, translate=False, icon=difference.line.icon)
    for name, line in ((here, difference.here), (there, difference.there)):
        if line is None:
            continue
        text = f"{name}: {localized(line.what)}"
        if not both:
            text = interface("{name}, {start:.1f} to {end:.1f} s", name=line.what, start=line.start_s, end=line.end_s)
        for i, part in enumerate(panel_rows(text)):
            row = layout.row()
            row.alignment = "LEFT"
            if name == here and i == 0:
                button = row.operator("unisim.go_to_edit", text=part, translate=False, icon="BLANK1", emboss=False)
                pressed(button, line)
            else:
                row.label(text=part, translate=False, icon="BLANK1")
