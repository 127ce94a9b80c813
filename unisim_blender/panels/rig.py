"""Panels Ego and Sensors: the vehicle and what is mounted on it."""

import bpy

from .sidebar import DrivePanel, row_of


class UNISIM_PT_ego(DrivePanel, bpy.types.Panel):
    """The vehicle that recorded the drive"""

    bl_label = "Ego"
    bl_order = 2
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the operators."""
        self.layout.operator("unisim.shift_ego", icon="ARROW_LEFTRIGHT")


class UNISIM_PT_sensors(DrivePanel, bpy.types.Panel):
    """Cameras and LiDARs on the vehicle"""

    bl_label = "Sensors"
    bl_order = 3
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the active sensor and the operators."""
        thing = context.active_object
        sensor = thing if thing is not None and thing.unisim.kind in ("CAMERA", "LIDAR") else None
        column = self.layout.column(align=True)
        row_of(column, "Sensor", sensor.name if sensor is not None else "", "CAMERA_DATA")
        column.operator("unisim.aim_sensor", icon="ORIENTATION_GIMBAL")
        column.operator("unisim.add_camera", icon="CAMERA_DATA")
        column.operator_menu_enum("unisim.add_lidar", "preset", text="Add LiDAR", icon="CONE")
        column.operator_menu_enum("unisim.set_beams", "preset", text="Change Beams", icon="LIGHT_SUN")


CLASSES = (UNISIM_PT_ego, UNISIM_PT_sensors)
