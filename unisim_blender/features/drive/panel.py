"""Panel Drive: what was imported, and what of it is shown."""

from pathlib import Path

import bpy

from ...bridge.objects.imported import imported_objects
from ...editing.texts import translatable
from ...translations import interface
from ...viewport.compare_view import draw_options
from ..sidebar import DrivePanel, row_of

POINTS = (
    ("None", False, False),
    ("Recorded", True, False),
    ("Simulated", False, True),
    (translatable("Both"), True, True),
)


class UNISIM_PT_drive(DrivePanel, bpy.types.Panel):
    """The drive that the scene was imported from"""

    bl_label = "Drive"
    bl_order = 1
    tasks = ("VIEW",)

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        about = scene.unisim
        column = layout.column(align=True)
        row_of(column, "Log", Path(about.log).name, "FILE_FOLDER")
        row_of(column, "Scene", Path(about.scene).name if about.scene else "", "SHADING_RENDERED")
        actors, sensors = (len(list(imported_objects(scene, *kinds))) for kinds in (("ACTOR",), ("CAMERA", "LIDAR")))
        text = interface("Actors: {actors}, sensors: {sensors}", actors=actors, sensors=sensors)
        row_of(column, "Contains", text, "OUTLINER_OB_GROUP_INSTANCE")
        layout.operator("unisim.import_sensors", icon="OUTLINER_OB_CAMERA")
        layout.operator("unisim.import_scene", text="Import Trained Scene", icon="IMPORT")


class UNISIM_PT_show(DrivePanel, bpy.types.Panel):
    """Parts of the drive that the view shows"""

    bl_label = "Show"
    bl_parent_id = "UNISIM_PT_drive"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw switches, and how LiDAR points are drawn; what does not apply is grey."""
        layout, about = self.layout, context.scene.unisim
        layout.use_property_split, layout.use_property_decorate = True, False
        draw_options(layout, context)
        layout.prop(about, "show_ways")
        layout.prop(about, "show_sensors")
        layout.prop(about, "show_timeline")
        layout.operator("unisim.recorded_colours", icon="COLOR")
        text = context.window_manager.unisim_points or interface("LiDAR Points")
        layout.label(text=text, translate=False, icon="POINTCLOUD_DATA")
        row = layout.row(align=True)
        for name, recorded, simulated in POINTS:
            now = (about.show_recorded, about.show_simulated) == (recorded, simulated)
            shown = row.operator("unisim.show_points", text=name, depress=now)
            shown.recorded, shown.simulated, shown.drops = recorded, simulated, about.show_drops
        column = layout.column()
        column.enabled = about.show_recorded or about.show_simulated
        column.prop(about, "points_colour", text="Colour by")
        switched = column.operator("unisim.show_points", text="Dropped Beams", depress=about.show_drops)
        switched.recorded, switched.simulated = about.show_recorded, about.show_simulated
        switched.drops = not about.show_drops
        beside = layout.column()
        beside.enabled = about.show_recorded
        beside.prop(about, "recorded_offset_m")
        layout.operator("unisim.birds_eye", icon="VIEW_ORTHO")
