"""Panel Sensors: cameras and LiDARs as a list, the active one's card, and rig presets."""

from typing import Any

import bpy
from bpy.props import IntProperty

from ...bridge.importing.rig_presets import own_presets
from ...bridge.objects.imported import drive_of
from ...bridge.views.sensor_facts import KINDS, card_of_sensor, size_of_sensor
from ...bridge.window import choose
from ...core.rigs import built_in_rigs
from ...editing.sensors.names import rate_of
from ...editing.texts import translatable
from ...translations import interface, localized
from ..sidebar import DrivePanel, row_of

WIDE = 330
"""Width of the sidebar from which on rows have the sensors' rates, in pixels at a scale of 1."""


def active_index(scene: bpy.types.Scene) -> int:
    """Return the active object's place among the scene's objects, -1 where no sensor is active."""
    active = bpy.context.view_layer.objects.active
    if active is None or active.unisim.kind not in KINDS:
        return -1
    return next((i for i, obj in enumerate(scene.objects) if obj == active), -1)


class UNISIM_UL_sensors(bpy.types.UIList):
    """Cameras and LiDARs of the drive; a click selects"""

    def draw_item(
        self, context: Any, layout: Any, data: Any, item: Any, icon: int, active_data: Any, active_propname: str
    ) -> None:
        """Draw the camera's button, name, resolution or beams, and whether it is rendered."""
        there, looked = not item.hide_render, data.camera == item
        row = layout.row(align=True)
        if item.unisim.kind == "CAMERA":
            look = row.row(align=True)
            look.enabled = there
            look.operator(
                "unisim.look_through", text="", icon="VIEW_CAMERA", depress=looked, emboss=looked
            ).name = item.name
        else:
            row.label(text="", icon="CONE")
        text = row.row(align=True)
        text.active = there
        text.label(text=item.name)
        size = text.row(align=True)
        size.alignment = "RIGHT"
        wide = context.region.width > WIDE * context.preferences.system.ui_scale
        size_text = localized(size_of_sensor(item))
        size.label(text=f"{size_text}, {rate_of(drive_of(data))}" if wide else size_text, translate=False)
        shown = "RESTRICT_RENDER_OFF" if there else "RESTRICT_RENDER_ON"
        row.operator("unisim.show_sensor", text="", icon=shown, emboss=False).name = item.name

    def filter_items(
        self, context: bpy.types.Context, data: bpy.types.Scene, propname: str
    ) -> tuple[list[int], list[int]]:
        """Keep the sensors, cameras first, by name."""
        every = list(getattr(data, propname))
        flags = [self.bitflag_filter_item if obj.unisim.kind in KINDS else 0 for obj in every]
        if self.filter_name:
            wanted = self.filter_name.lower()
            flags = [flag if wanted in obj.name.lower() else 0 for flag, obj in zip(flags, every, strict=True)]
        named = [(i, obj.unisim.kind, obj.name) for i, obj in enumerate(every)]
        return flags, bpy.types.UI_UL_list.sort_items_helper(named, key=lambda item: item[1:])


class UNISIM_MT_rig_presets(bpy.types.Menu):
    """Put a rig on the vehicle: built-in ones, which approximate public data sets, and your own"""

    bl_label = "Rig Presets"
    bl_description = "Put a rig on the vehicle: built-in ones, which approximate public data sets, and your own"

    def draw(self, context: bpy.types.Context) -> None:
        layout = self.layout
        built_in = translatable("Built-in"), translatable("Built-in: none yet"), built_in_rigs()
        own = translatable("Own"), translatable("Own: none yet"), own_presets()
        for title, nothing, files in (built_in, own):
            layout.label(text=title if files else nothing)
            for path in files:
                layout.operator("unisim.apply_rig", text=path.stem, icon="OUTLINER_OB_CAMERA").filepath = str(path)
            layout.separator()
        layout.operator("unisim.rig_folder", icon="FILE_FOLDER")


class UNISIM_MT_remove_rig(bpy.types.Menu):
    """Delete one of your own rig presets"""

    bl_label = "Remove Rig Preset"
    bl_description = "Delete one of your own rig presets"

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.operator_context = "INVOKE_DEFAULT"
        files = own_presets()
        for path in files:
            self.layout.operator("unisim.remove_rig", text=path.stem, icon="TRASH").filepath = str(path)
        if not files:
            self.layout.label(text="No presets of your own yet")


class UNISIM_PT_sensors(DrivePanel, bpy.types.Panel):
    """Cameras and LiDARs of the drive"""

    bl_label = "Sensors"
    bl_order = 5
    tasks = ("VIEW", "EDIT")
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the list, the active sensor, presets and operators; rows stay in place whatever is selected."""
        layout, scene, obj = self.layout, context.scene, context.active_object
        sensor = obj if obj is not None and obj.unisim.kind in KINDS and obj.name in scene.objects else None
        layout.template_list("UNISIM_UL_sensors", "", scene, "objects", scene, "unisim_sensor_index", rows=4)
        drive = drive_of(scene)
        card = None if sensor is None else card_of_sensor(scene, sensor, drive)
        box = layout.box().column(align=True)
        row_of(box, "Sensor", sensor.name if sensor else interface("none is active"), "CAMERA_DATA")
        row_of(box, "Measures", ", ".join((localized(size_of_sensor(sensor)), rate_of(drive))) if sensor else "")
        row_of(box, "State", localized(card.state) if card else "")
        row_of(box, "Direction", localized(card.view) if card else "")
        row_of(box, "Mount", localized(card.mount) if card else "")
        if sensor is not None:
            row = box.split(factor=0.36)
            row.label(text="Sees body")
            row.prop(sensor.unisim, "sees_ego_body", text="")
        else:
            row_of(box, "Sees body", "")
        row = layout.row(align=True)
        row.menu("UNISIM_MT_rig_presets", icon="PRESET")
        row.operator("unisim.save_rig", text="", icon="ADD")
        row.menu("UNISIM_MT_remove_rig", text="", icon="REMOVE")
        column = layout.column(align=True)
        column.operator("unisim.restore_sensors", icon="LOOP_BACK")
        column.operator("unisim.add_camera", icon="CAMERA_DATA")
        column.operator_menu_enum("unisim.add_lidar", "preset", text="Add LiDAR", icon="CONE")
        column.operator_menu_enum("unisim.set_beams", "preset", text="Change Beams", icon="LIGHT_SUN")
        column.operator("unisim.aim_sensor", icon="ORIENTATION_GIMBAL")


PROPERTIES = (
    (
        bpy.types.Scene,
        "unisim_sensor_index",
        IntProperty(get=active_index, set=lambda scene, index: choose(bpy.context, scene.objects[index])),
    ),
)
