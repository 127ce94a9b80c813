"""The recording vehicle in another lane."""

import bpy
from bpy.props import FloatProperty

from ..bridge.motion import displaced_along
from ..bridge.things import things


class UNISIM_OT_shift_ego(bpy.types.Operator):
    """Let the recording vehicle, with its sensors, drive further left or right"""

    bl_idname = "unisim.shift_ego"
    bl_label = "Shift Ego Lane"
    bl_options = {"REGISTER", "UNDO"}

    left_m: FloatProperty(name="Left", description="Negative: to the right", default=1.0, unit="LENGTH")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The vehicle has to be there."""
        return context.mode == "OBJECT" and next(things(context.scene, "EGO"), None) is not None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Move its keys."""
        for ego in things(context.scene, "EGO"):
            displaced_along(ego, (0.0, self.left_m, 0.0))
        return {"FINISHED"}


CLASSES = (UNISIM_OT_shift_ego,)
