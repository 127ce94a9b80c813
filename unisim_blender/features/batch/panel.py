"""Panel Batch: which variants, with which values of parameters, where they go and who runs them."""

from __future__ import annotations

from typing import Any

import bpy

from ...bridge.changes.variants import variants_of
from ...translations import interface
from ..sidebar import DrivePanel, draw_task, optional_row, settings_column, text_row
from ..simulation.properties import driver_of
from .operators import BatchTask, count_of


class UNISIM_PT_batch(DrivePanel, bpy.types.Panel):
    """Many scenarios at once, rendered or driven through"""

    bl_label = "Batch"
    bl_order = 3
    tasks = ("SIMULATE", "RENDER")
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        about = scene.unisim_batch
        column = layout.column(align=True)
        for variant in variants_of(scene):
            column.prop(variant.unisim_edits, "rendered", text=variant.name, translate=False)
        for index, parameter in enumerate(about.parameters):
            draw_parameter(layout.box().column(align=True), parameter, index)
        layout.operator("unisim.add_parameter", icon="ADD")
        column = settings_column(layout)
        column.prop(about, "driven")
        row = column.row()
        row.active = about.driven
        driver = driver_of(scene) or interface("none: see Simulate")
        row.label(text=interface("Driver: {name}", name=driver), translate=False)
        column.prop(about, "executor")
        row = column.row()
        row.enabled = about.executor == "ray"
        text_row(row, "This machine", about, "address")
        optional_row(column, "Workers", "One a core", about, "has_jobs", "jobs")
        column.prop(about, "out")
        layout.label(text=interface("Scenarios: {count}", count=count_of(scene)), translate=False, icon="COPYDOWN")
        layout.operator("unisim.submit_batch", icon="PLAY")
        draw_task(layout, scene, BatchTask)
        layout.operator("unisim.open_report", icon="URL")


def draw_parameter(column: bpy.types.UILayout, parameter: Any, index: int) -> None:
    """Draw a parameter: its name, the field that it fills, and its values."""
    row = column.row(align=True)
    row.prop(parameter, "name", text="")
    row.operator("unisim.remove_parameter", text="", icon="X").index = index
    if parameter.name != parameter.about:
        column.label(text=parameter.about or parameter.at, translate=False)
    column.row(align=True).prop(parameter, "kind", expand=True)
    if parameter.kind == "VALUES":
        column.prop(parameter, "values", text="")
        return
    row = column.row(align=True)
    row.prop(parameter, "start")
    row.prop(parameter, "stop")
    column.prop(parameter, "count")
