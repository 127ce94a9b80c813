"""Panel Motion: speed, accelerations and curvature of the active object, their limits, and what of
motion the view shows."""

import bpy

from ...bridge.sampling.stepping import frame_of
from ...editing.layout.speed_graph import values
from ...editing.motion.kinematics import QUANTITIES
from ...translations import localized
from ..sidebar import DrivePanel, row_of, settings_column
from .properties import graph_of

ROWS = ("Speed", "Acceleration", "Lateral", "Curvature")


class UNISIM_PT_motion(DrivePanel, bpy.types.Panel):
    """Motion of the active actor or the ego vehicle at the frame that is shown, and its limits"""

    bl_label = "Motion"
    bl_parent_id = "UNISIM_PT_actor"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        graph = graph_of(context)
        texts = values(graph, frame_of(scene))[1:] if graph is not None else []
        box = layout.box().column(align=True)
        for i, name in enumerate(ROWS):
            text, is_over = texts[i] if i < len(texts) else ("", False)
            row = box.row()
            row.alert = is_over
            row_of(row, name, localized(text), "ERROR" if is_over else "NONE")
        layout.prop(scene.unisim_motion, "show_graph")
        column = settings_column(layout, align=True)
        column.label(text="Limits of vehicles")
        for name in QUANTITIES:
            column.prop(scene.unisim_motion, name)
