"""The recording vehicle in another lane."""

import bpy
from bpy.props import FloatProperty

from ...bridge.changes.motion import displaced_along
from ...bridge.objects.imported import imported_objects
from ...bridge.window.polling import allowed, object_mode, vehicle
from ...bridge.window.refresh import refresh


class UNISIM_OT_shift_ego(bpy.types.Operator):
    """Displace the trajectory of the ego vehicle and its sensors to the left or right"""

    bl_idname = "unisim.shift_ego"
    bl_label = "Shift Ego Lane"
    bl_options = {"REGISTER", "UNDO"}

    left_m: FloatProperty(
        name="Left",
        description="Displacement to the left; negative values displace to the right",
        default=1.0,
        unit="LENGTH",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The vehicle has to be there."""
        return allowed(cls, object_mode(context), vehicle(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Displace its whole trajectory."""
        vehicles = list(imported_objects(context.scene, "EGO"))
        for ego in vehicles:
            displaced_along(ego, (0.0, self.left_m, 0.0))
        refresh(vehicles)
        return {"FINISHED"}


CLASSES = (UNISIM_OT_shift_ego,)
