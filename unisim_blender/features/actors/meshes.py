"""Ordinary objects made actors: objects that nobody recorded."""

import bpy
from bpy.props import EnumProperty, StringProperty

from ...bridge.objects.mesh_objects import make_actor
from ...bridge.objects.meshes import parts
from ...bridge.window.polling import allowed, drive, object_mode, selected
from ...bridge.window.selection import choose, chosen
from ...translations import message

DIRECTIONS = (
    ("AUTO", "Longest Axis", "Along world X or Y, whichever the object is longer in"),
    ("X", "X", "The object points along world X"),
    ("-X", "-X", "The object points along world -X"),
    ("Y", "Y", "The object points along world Y"),
    ("-Y", "-Y", "The object points along world -Y"),
)


def marked_above(obj: bpy.types.Object) -> bool:
    """Whether an object is part of an actor, or of one that is selected with it."""
    above = obj.parent
    while above is not None:
        if above.unisim.mesh or above.select_get():
            return True
        above = above.parent
    return False


class UNISIM_OT_mesh_actor(bpy.types.Operator):
    """Use the selected mesh objects and their children as actors, which cameras and LiDARs see"""

    bl_idname = "unisim.mesh_actor"
    bl_label = "Use Mesh as Actor"
    bl_options = {"REGISTER", "UNDO"}

    label: StringProperty(
        name="Class",
        description="Class name as in the labels of the log, for example Car, Pedestrian or Cones",
        default="Car",
    )
    forward: EnumProperty(name="Points along", description="Forward direction of the object", items=DIRECTIONS)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """An object that is nothing of the drive yet has to be selected."""
        needed = selected(context, "Select a mesh object that is not part of the drive yet", "NONE")
        return allowed(cls, object_mode(context), drive(context), needed)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Mark each; its origin goes to its middle, its scale into its mesh."""
        found = [obj for obj in chosen(context, "NONE") if not marked_above(obj) and any(parts(obj))]
        if not found:
            self.report({"ERROR"}, message("no selected object has a surface"))
            return {"CANCELLED"}
        for obj in found:
            make_actor(obj, self.label or "Other", self.forward)
        choose(context, *found)
        self.report({"INFO"}, message("Mesh actors: {count}", count=len(found)))
        return {"FINISHED"}


class UNISIM_OT_release_mesh(bpy.types.Operator):
    """Turn the selected mesh actors back into ordinary objects, which no sensor sees"""

    bl_idname = "unisim.release_mesh"
    bl_label = "Release Mesh Actor"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A mesh that is an actor has to be selected."""
        meshes = any(obj.unisim.mesh for obj in chosen(context, "ACTOR"))
        return allowed(cls, object_mode(context), (meshes, "Select a mesh actor first"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Take the mark away."""
        for obj in chosen(context, "ACTOR"):
            if obj.unisim.mesh:
                obj.unisim.kind, obj.unisim.mesh = "NONE", False
        return {"FINISHED"}


CLASSES = (UNISIM_OT_mesh_actor, UNISIM_OT_release_mesh)
