"""Panels Check and Output, and where quality stands beside them: Render Properties and the view's header."""

import bpy

from ..operators.background import curve_icon
from ..registering import add, take_away
from .sidebar import DrivePanel


class UNISIM_PT_warnings(DrivePanel, bpy.types.Panel):
    """What is not plausible about the edits"""

    bl_label = "Check"
    bl_order = 4

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a line for each finding, which jumps to the place."""
        self.layout.operator("unisim.check", icon="CHECKMARK")
        column = self.layout.column(align=True)
        for warning in context.window_manager.unisim_warnings:
            text = f"{warning.frame}: {warning.name} {warning.text}"
            there = column.operator("unisim.go_to", text=text, icon="ERROR")
            there.thing, there.frame = warning.name, warning.frame


class UNISIM_PT_output(DrivePanel, bpy.types.Panel):
    """Images and sweeps of the whole drive"""

    bl_label = "Output"
    bl_order = 5

    def draw(self, context: bpy.types.Context) -> None:
        """Draw settings, what runs, and the export."""
        layout, about, manager = self.layout, context.scene.unisim, context.window_manager
        column = layout.column()
        column.use_property_split, column.use_property_decorate = True, False
        column.prop(about, "out")
        column.prop(about, "quality")
        column.column().prop(about, "passes")
        column.prop(about, "opacity_pass")
        column.prop(about, "contact_shadows")
        column.prop(about, "clip_render")
        layout.operator("unisim.render_sequence", icon="RENDER_ANIMATION")
        layout.progress(factor=manager.unisim_progress, text=manager.unisim_task or "Nothing runs")
        layout.operator("unisim.cancel_task", icon="CANCEL")
        layout.operator("unisim.export_scenario", icon="EXPORT")
        layout.operator("unisim.train", icon="MODIFIER")
        layout.operator("unisim.make_library", icon="ASSET_MANAGER")
        curve = curve_icon()
        if curve is not None:
            layout.template_icon(curve, scale=12.0)


class UNISIM_PT_render(bpy.types.Panel):
    """How finely the engine UniSim samples rays"""

    bl_label = "Sampling"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {"UNISIM"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The engine has to be UniSim."""
        return context.scene.render.engine in cls.COMPAT_ENGINES

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the settings."""
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(context.scene.unisim, "quality")
        layout.prop(context.scene.unisim, "contact_shadows")


def draw_quality(self: bpy.types.Header, context: bpy.types.Context) -> None:
    """Draw the quality in the header of a view that the engine draws."""
    if context.scene.render.engine == "UNISIM" and context.space_data.shading.type == "RENDERED":
        self.layout.prop(context.scene.unisim, "quality", text="")


CLASSES = (UNISIM_PT_warnings, UNISIM_PT_output, UNISIM_PT_render)


def register() -> None:
    """Add the panels and the quality in the view's header."""
    add(CLASSES)
    bpy.types.VIEW3D_HT_header.append(draw_quality)


def unregister() -> None:
    """Take them away."""
    bpy.types.VIEW3D_HT_header.remove(draw_quality)
    take_away(CLASSES)
