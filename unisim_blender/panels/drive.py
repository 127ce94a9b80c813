"""The sidebar's tab UniSim."""

import json
from pathlib import Path

import bpy

from ..bridge.importing import recorded_colours
from ..bridge.things import things
from ..operators.background import curve_icon


class _Sidebar:
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "UniSim"


class UNISIM_PT_drive(_Sidebar, bpy.types.Panel):
    """The drive that the scene was imported from"""

    bl_label = "Drive"

    def draw(self, context: bpy.types.Context) -> None:
        """Log, trained scene, what is there, and a warning where colours are not as recorded."""
        layout, scene = self.layout, context.scene
        about = scene.unisim
        if not about.log:
            layout.label(text="No drive yet", icon="INFO")
            layout.operator("unisim.import_log", text="Import Driving Log", icon="IMPORT")
            layout.operator("unisim.import_scene", text="Import Trained Scene", icon="IMPORT")
            return
        layout.label(text=f"Log: {Path(about.log).name}", icon="FILE_FOLDER")
        if about.scene:
            layout.label(text=f"Trained scene: {Path(about.scene).name}", icon="SHADING_RENDERED")
        else:
            layout.operator("unisim.import_scene", text="Import Trained Scene", icon="IMPORT")
        actors = list(things(scene, "ACTOR"))
        layout.label(text=f"{len(actors)} actors, {sum(1 for _ in things(scene, 'CAMERA', 'LIDAR'))} sensors")
        row = layout.row(align=True)
        for name, recorded, simulated in (
            ("Recorded", True, False),
            ("Simulated", False, True),
            ("Both", True, True),
            ("None", False, False),
        ):
            shown = row.operator(
                "unisim.show_points", text=name, depress=(about.show_recorded, about.show_simulated) == (recorded, simulated)
            )
            shown.recorded, shown.simulated = recorded, simulated
        if about.show_recorded or about.show_simulated:
            layout.row(align=True).prop(about, "points_colour", expand=True)
        if about.show_recorded:
            layout.prop(about, "recorded_offset_m")
        row = layout.row(align=True)
        row.prop(about, "show_ways", toggle=True)
        row.prop(about, "show_sensors", toggle=True)
        if not recorded_colours(scene):
            layout.label(text="Colours are not shown as recorded", icon="ERROR")
            layout.operator("unisim.recorded_colours")


class UNISIM_PT_edit(_Sidebar, bpy.types.Panel):
    """What can be done with what is selected"""

    bl_label = "Edit"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return bool(context.scene.unisim.log)

    def draw(self, context: bpy.types.Context) -> None:
        """Operators, and what the active object is."""
        layout, thing = self.layout, context.active_object
        if thing is not None and thing.unisim.kind == "STATIC":
            size = json.loads(thing.unisim.model)["size_m"]
            layout.label(text=f"{thing.name}: box of {size[0]:.2f} x {size[1]:.2f} x {size[2]:.2f} m")
        elif thing is not None and thing.unisim.kind != "NONE":
            copy = "" if thing.name == thing.unisim.home else " (a mesh)" if thing.unisim.mesh else " (a copy)"
            layout.label(text=f"{thing.name}{copy}")
        column = layout.column(align=True)
        column.operator_menu_enum("unisim.duplicate_actor", "where", text="Duplicate Actor")
        column.operator("unisim.delete_actor")
        column.operator("unisim.replace_look")
        column.operator("unisim.insert_actor")
        column.operator_menu_enum("unisim.retime_actor", "way", text="Retime Actor")
        column.operator("unisim.follow_curve")
        column.operator("unisim.snap_to_ground")
        column.operator("unisim.mesh_actor")
        column.operator("unisim.release_mesh")
        column = layout.column(align=True)
        column.operator("unisim.mark_static")
        column.operator("unisim.copy_static")
        column.operator("unisim.forget_static")
        column = layout.column(align=True)
        column.operator("unisim.shift_ego")
        column.operator("unisim.add_camera")
        column.operator_menu_enum("unisim.add_lidar", "preset", text="Add LiDAR")
        column.operator_menu_enum("unisim.set_beams", "preset", text="Change Beams")


class UNISIM_PT_warnings(_Sidebar, bpy.types.Panel):
    """What is not plausible about the edits"""

    bl_label = "Warnings"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return bool(context.scene.unisim.log)

    def draw(self, context: bpy.types.Context) -> None:
        """A line for each, which jumps to the place."""
        self.layout.operator("unisim.check")
        column = self.layout.column(align=True)
        for warning in context.window_manager.unisim_warnings:
            there = column.operator("unisim.go_to", text=f"{warning.frame}: {warning.name} {warning.text}", icon="ERROR")
            there.thing, there.frame = warning.name, warning.frame


class UNISIM_PT_output(_Sidebar, bpy.types.Panel):
    """Pictures and sweeps"""

    bl_label = "Output"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return bool(context.scene.unisim.log)

    def draw(self, context: bpy.types.Context) -> None:
        """Settings, what runs, and the export."""
        about, manager = context.scene.unisim, context.window_manager
        self.layout.prop(about, "out")
        self.layout.prop(about, "quality")
        self.layout.prop(about, "passes")
        self.layout.prop(about, "opacity_pass")
        self.layout.prop(about, "contact_shadows")
        self.layout.operator("unisim.render_sequence", icon="RENDER_ANIMATION")
        if manager.unisim_task:
            self.layout.progress(factor=manager.unisim_progress, text=manager.unisim_task)
            self.layout.operator("unisim.cancel_task")
            curve = curve_icon()
            if curve is not None:
                self.layout.template_icon(curve, scale=12.0)
        self.layout.operator("unisim.export_scenario")
        self.layout.operator("unisim.train")
        self.layout.operator("unisim.make_library")


CLASSES = (UNISIM_PT_drive, UNISIM_PT_edit, UNISIM_PT_warnings, UNISIM_PT_output)
