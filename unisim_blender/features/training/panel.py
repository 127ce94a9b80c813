"""Panel Training and Assets, a part of the panel Output."""

import bpy

from ...process.background import curve_icon
from ..sidebar import DrivePanel


class UNISIM_PT_training(DrivePanel, bpy.types.Panel):
    """What is made of the whole drive once"""

    bl_label = "Training and Assets"
    bl_parent_id = "UNISIM_PT_output"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the operators, and how a training goes."""
        layout = self.layout
        layout.operator("unisim.train", icon="MODIFIER")
        layout.operator("unisim.make_library", icon="ASSET_MANAGER")
        curve = curve_icon()
        if curve is not None:
            layout.template_icon(curve, scale=12.0)


CLASSES = (UNISIM_PT_training,)
