"""Panel Output, and the quality in Render Properties."""

import bpy

from ...bridge.objects.settings import captures_stated
from ...core.scenario.types import FRAME_FORMATS, SEQUENCE_FORMATS
from ...editing.reading.scenario import captures_words
from ...process.background import running
from ...process.tasks import SequenceTask
from ...translations import interface, localized
from ..sidebar import DrivePanel, Sidebar, draw_task, optional_row, settings_column
from .operators import FilmTask, film_of, results_of


class UNISIM_PT_output(Sidebar, bpy.types.Panel):
    """Images and sweeps of the whole drive"""

    bl_label = "Output"
    bl_order = 1
    tasks = ("RENDER",)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there, or a task that runs for another file."""
        return bool(context.scene.unisim.log or running) and super().poll(context)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw settings, what runs, and the export; in a file without a drive only what runs."""
        layout, about = self.layout, context.scene.unisim
        if not about.log:
            draw_task(layout, context.scene, type(running[0]))
            return
        column = settings_column(layout)
        column.prop(about, "out")
        column.prop(about, "sequence_sensors")
        optional_row(column, "Width", "Each camera's own", about, "has_sequence_width", "sequence_width")
        column.prop(about, "quality")
        draw_captures(layout, context.scene)
        layout.operator("unisim.render_sequence", icon="RENDER_ANIMATION")
        draw_task(layout, context.scene, SequenceTask, FilmTask)
        draw_results(layout, context)
        layout.operator("unisim.export_scenario", icon="EXPORT")


def draw_captures(layout: bpy.types.UILayout, scene: bpy.types.Scene) -> None:
    """Draw which captures a sequence has: those that the imported scenario states, or the frame range."""
    row = layout.row(align=True)
    if captures_stated(scene):
        row.label(text=localized(captures_words(scene.unisim.stated)), translate=False, icon="TIME")
        row.operator("unisim.use_frame_range", text="", icon="X")
    else:
        first, last, step = scene.frame_start, scene.frame_end, scene.frame_step
        text = interface("Frames {first} to {last}", first=first, last=last)
        text = text if step == 1 else interface("{frames}, step {step}", frames=text, step=step)
        row.label(text=text, translate=False, icon="TIME")


class UNISIM_PT_passes(DrivePanel, bpy.types.Panel):
    """Passes of images besides colours, and effects"""

    bl_label = "Passes and Effects"
    bl_parent_id = "UNISIM_PT_output"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        about, column = context.scene.unisim, settings_column(self.layout)
        column.column().prop(about, "passes")
        column.prop(about, "opacity_pass")
        column.prop(about, "contact_shadows")
        column.prop(about, "fill_ground")
        column.prop(about, "fixer")
        column.prop(about, "detail")
        column.prop(about, "clip_render")


def draw_results(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Draw the buttons for what a sequence left: with images of several cameras, playing them is a menu."""
    row = layout.row(align=True)
    row.operator("unisim.open_output", icon="FILE_FOLDER")
    if len(results_of(context.scene)) > 1:
        row.operator_menu_enum("unisim.play_result", "camera", icon="PLAY")
    else:
        row.operator("unisim.play_result", icon="PLAY")
    row = layout.row(align=True)
    row.operator("unisim.make_film", icon="RENDER_ANIMATION")
    film = film_of(context.scene)
    is_page = film is not None and film.suffix == ".html"
    text = interface("Open Film Page") if is_page else interface("Open Film")
    row.operator("unisim.open_film", text=text, translate=False, icon="FILE_MOVIE")


class UNISIM_PT_formats(DrivePanel, bpy.types.Panel):
    """Formats of sequences: files of frames, and files of the whole"""

    bl_label = "Formats"
    bl_parent_id = "UNISIM_PT_output"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        for formats in (FRAME_FORMATS, SEQUENCE_FORMATS):
            grid = self.layout.grid_flow(row_major=True, columns=3, even_columns=True, align=True)
            for name in formats:
                grid.prop_enum(context.scene.unisim, "formats", name)


class UNISIM_PT_render(bpy.types.Panel):
    """Sampling settings of the engine UniSim"""

    bl_label = "Sampling"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {"UNISIM"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.render.engine in cls.COMPAT_ENGINES

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        layout.prop(context.scene.unisim, "quality")
        layout.prop(context.scene.unisim, "contact_shadows")
        layout.prop(context.scene.unisim, "fill_ground")
        layout.prop(context.scene.unisim, "detail")
