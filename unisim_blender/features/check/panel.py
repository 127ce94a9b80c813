"""Panel Check: what is not plausible about the edits."""

import bpy

from ...editing.texts import UPPER, cased, unpacked
from ...translations import localized
from ..sidebar import DrivePanel
from .operators import is_outdated


class UNISIM_PT_warnings(DrivePanel, bpy.types.Panel):
    """What is not plausible about the edits"""

    bl_label = "Check"
    bl_order = 7

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a line for each finding, which jumps to the place."""
        self.layout.operator("unisim.check", icon="CHECKMARK")
        check, outdated = context.scene.unisim_check, is_outdated(context.scene)
        if not check.state:
            self.layout.label(text="Not checked yet", icon="BLANK1")
            return
        if outdated:
            self.layout.label(text="Edited since the check", icon="FILE_REFRESH")
        elif not check.warnings:
            self.layout.label(text="No warnings", icon="BLANK1")
        column = self.layout.column(align=True)
        column.active = not outdated
        for warning in check.warnings:
            text = f"{warning.time_s:.1f} s ({warning.frame})  {warning.name}"
            there = column.operator("unisim.go_to", text=text, translate=False, icon="ERROR")
            text = localized(cased(unpacked(warning.text_parts, warning.text), UPPER))
            column.label(text=text, translate=False)
            there.object_name, there.frame, there.place = warning.name, warning.frame, warning.place


CLASSES = (UNISIM_PT_warnings,)
