"""Actors copied and deleted."""

import bpy
from bpy.props import EnumProperty, FloatProperty

from ...bridge.changes.motion import displaced_along, moved_to
from ...bridge.objects.copies import copy_of
from ...bridge.objects.meshes import size_of
from ...bridge.objects.trajectories import remove
from ...bridge.sampling.stepping import frame_of
from ...bridge.window.polling import allowed, object_mode, selected
from ...bridge.window.refresh import refresh
from ...bridge.window.selection import choose, chosen
from ...translations import message

LANE_M = 3.5
GAP_M = 0.6
PLACES = (
    ("IN_PLACE", "In place", "At the location of the source, to be moved with Blender's tools"),
    ("LEFT", "Beside, left", "Left of the source with a gap of 0.6 m"),
    ("RIGHT", "Beside, right", "Right of the source with a gap of 0.6 m"),
    ("LANE_LEFT", "Next lane, left", "One lane to the left"),
    ("LANE_RIGHT", "Next lane, right", "One lane to the right"),
    ("CURSOR", "At the 3D cursor", "At the 3D cursor in the current frame, on the same trajectory"),
)


class UNISIM_OT_duplicate_actor(bpy.types.Operator):
    """Duplicate the selected actors with their trajectories"""

    bl_idname = "unisim.duplicate_actor"
    bl_label = "Duplicate Actor"
    bl_options = {"REGISTER", "UNDO"}

    where: EnumProperty(name="Where", description="Location of the copies", items=PLACES, default="LANE_LEFT")
    lane_m: FloatProperty(
        name="Lane width", description="Distance to the next lane", default=LANE_M, min=0.5, soft_max=6.0, unit="LENGTH"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An actor has to be selected."""
        return allowed(cls, object_mode(context), selected(context, "Select an actor first", "ACTOR"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Copy each and put the copy where it was asked for."""
        sources, copies = chosen(context, "ACTOR"), []
        for source in sources:
            copy = copy_of(context, source)
            if self.where == "CURSOR":
                moved_to(copy, context.scene.cursor.location, frame_of(context.scene))
            elif self.where != "IN_PLACE":
                beside = float(size_of(source)[1]) + GAP_M if self.where in ("LEFT", "RIGHT") else self.lane_m
                displaced_along(copy, (0.0, beside if self.where.endswith("LEFT") else -beside, 0.0))
            copies.append(copy)
        choose(context, *copies)
        refresh(copies)
        self.report({"INFO"}, message("Actors duplicated: {count}", count=len(sources)))
        return {"FINISHED"}


class UNISIM_OT_delete_actor(bpy.types.Operator):
    """Delete the selected actors and static items from all images and sweeps"""

    bl_idname = "unisim.delete_actor"
    bl_label = "Delete Actor"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An actor or a static item has to be selected."""
        needed = selected(context, "Select an actor or a static item first", "ACTOR", "STATIC")
        return allowed(cls, object_mode(context), needed)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """As X does."""
        gone = chosen(context, "ACTOR", "STATIC")
        for obj in gone:
            for part in obj.children_recursive if obj.unisim.mesh else ():
                bpy.data.objects.remove(part)
            remove(obj)
        self.report({"INFO"}, message("Objects deleted: {count}", count=len(gone)))
        return {"FINISHED"}


CLASSES = (UNISIM_OT_duplicate_actor, UNISIM_OT_delete_actor)
