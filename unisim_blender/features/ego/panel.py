"""Panel Ego: the vehicle that recorded the drive."""

import bpy

from ..sidebar import DrivePanel, row_of


class UNISIM_PT_ego(DrivePanel, bpy.types.Panel):
    """The vehicle that recorded the drive"""

    bl_label = "Ego"
    bl_order = 5
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the operators."""
        bodies = [obj.name for obj in context.scene.objects if obj.unisim.kind == "BODY"]
        column = self.layout.column(align=True)
        row_of(column, "Body", ", ".join(bodies), "AUTO")
        column.operator("unisim.ego_body", icon="MESH_MONKEY")
        column.operator("unisim.release_ego_body", icon="X")
        self.layout.operator("unisim.shift_ego", icon="ARROW_LEFTRIGHT")


CLASSES = (UNISIM_PT_ego,)
