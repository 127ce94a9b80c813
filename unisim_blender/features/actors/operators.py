"""Actors copied and deleted, meshes as actors, and boxes of space as static items."""

import bpy
import numpy as np
from bpy.props import EnumProperty, FloatVectorProperty, StringProperty

from ...bridge.changes.carriers.own_object import discard
from ...bridge.changes.motion import displaced_beside, moved_to
from ...bridge.objects.imported import copy_of, forget_static, mark_static, source_of
from ...bridge.objects.meshes import make_actor, parts, size_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.window import Need, choose, chosen, drive, object_mode, selected
from ...core.errors import UnisimError
from ...editing.sampled.scene import rigid
from ...translations import message
from ..operator_bases import EditsObjects, in_metres

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


class UNISIM_OT_duplicate_actor(EditsObjects, bpy.types.Operator):
    """Duplicate the selected actors with their trajectories"""

    bl_label = "Duplicate Actor"
    needs = (object_mode, selected("Select an actor first", "ACTOR"))

    where: EnumProperty(name="Where", description="Location of the copies", items=PLACES, default="LANE_LEFT")
    lane_m: in_metres("Lane width", "Distance to the next lane", LANE_M, once=False, min=0.5, soft_max=6.0)

    def edit(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        sources, copies, recorded = chosen(context, "ACTOR"), [], source_of(context.scene).drive
        for source in sources:
            copy = copy_of(context, source)
            if self.where == "CURSOR":
                moved_to(copy, context.scene.cursor.location, frame_of(context.scene))
            elif self.where != "IN_PLACE":
                beside = float(size_of(source)[1]) + GAP_M if self.where in ("LEFT", "RIGHT") else self.lane_m
                displaced_beside(copy, (0.0, beside if self.where.endswith("LEFT") else -beside, 0.0), recorded)
            copies.append(copy)
        choose(context, *copies)
        self.report({"INFO"}, message("Actors duplicated: {count}", count=len(sources)))
        return copies


class UNISIM_OT_delete_actor(EditsObjects, bpy.types.Operator):
    """Delete the selected actors and static items from all images and sweeps"""

    bl_label = "Delete Actor"
    needs = (object_mode, selected("Select an actor or a static item first", "ACTOR", "STATIC"))

    def edit(self, context: bpy.types.Context) -> None:
        gone = chosen(context, "ACTOR", "STATIC")
        for obj in gone:
            discard(obj)
        self.report({"INFO"}, message("Objects deleted: {count}", count=len(gone)))


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


def selected_meshes(context: bpy.types.Context) -> list[bpy.types.Object]:
    """Return the selected mesh objects that are no part of the drive or of another one. Raises `UnisimError` where there
    is none."""
    meshes = [obj for obj in chosen(context, "NONE") if not marked_above(obj) and any(parts(obj))]
    if not meshes:
        raise UnisimError(message("no selected object has a surface"))
    return meshes


class UNISIM_OT_mesh_actor(EditsObjects, bpy.types.Operator):
    """Use the selected mesh objects and their children as actors, which cameras and LiDARs see"""

    bl_label = "Use Mesh as Actor"
    needs = (object_mode, drive, selected("Select a mesh object that is not part of the drive yet", "NONE"))

    label: StringProperty(
        name="Class",
        description="Class name as in the labels of the log, for example Car, Pedestrian or Cones",
        default="Car",
    )
    forward: EnumProperty(name="Points along", description="Forward direction of the object", items=DIRECTIONS)

    def edit(self, context: bpy.types.Context) -> None:
        """Mark each; its origin goes to its middle, its scale into its mesh."""
        meshes = selected_meshes(context)
        for obj in meshes:
            make_actor(obj, self.label or "Other", self.forward)
        choose(context, *meshes)
        self.report({"INFO"}, message("Mesh actors: {count}", count=len(meshes)))


def mesh_actor(context: bpy.types.Context) -> Need:
    """A mesh that is an actor is selected."""
    return any(obj.unisim.mesh for obj in chosen(context, "ACTOR")), "Select a mesh actor first"


class UNISIM_OT_release_mesh(EditsObjects, bpy.types.Operator):
    """Turn the selected mesh actors back into ordinary objects, which no sensor sees"""

    bl_label = "Release Mesh Actor"

    needs = (object_mode, mesh_actor)

    def edit(self, context: bpy.types.Context) -> None:
        for obj in chosen(context, "ACTOR"):
            if obj.unisim.mesh:
                obj.unisim.kind, obj.unisim.mesh = "NONE", False


class UNISIM_OT_mark_static(EditsObjects, bpy.types.Operator):
    """Mark a static item: the bounding box of the selected active mesh, or a new box at the 3D cursor"""

    bl_label = "Mark Static Item"
    needs = (object_mode, drive)

    size_m: FloatVectorProperty(
        name="Size",
        description="Size of the new box",
        default=(0.6, 0.6, 1.0),
        min=0.02,
        subtype="XYZ_LENGTH",
        unit="LENGTH",
    )

    def edit(self, context: bpy.types.Context) -> None:
        active = context.active_object
        if active is not None and active.select_get() and active.type == "MESH" and active.unisim.kind == "NONE":
            corners = np.array(active.bound_box)
            low, high = corners.min(0), corners.max(0)
            world = np.array(active.matrix_world, float)
            size = np.maximum((high - low) * np.linalg.norm(world[:3, :3], axis=0), 0.02)
            pose = rigid(world)
            pose[:3, 3] = world[:3, :3] @ ((low + high) / 2) + world[:3, 3]
            bpy.data.objects.remove(active)
        else:
            size, pose = np.array(self.size_m), np.eye(4)
            pose[:3, 3] = np.array(context.scene.cursor.location) + [0.0, 0.0, size[2] / 2]
        obj = mark_static(context.scene, pose, size)
        choose(context, obj)


class UNISIM_OT_copy_static(EditsObjects, bpy.types.Operator):
    """Copy the selected static items to the 3D cursor"""

    bl_label = "Copy Static Item"
    needs = (object_mode, selected("Select a static item first", "STATIC"))

    def edit(self, context: bpy.types.Context) -> None:
        """Several keep their places to each other."""
        items = chosen(context, "STATIC")
        middle = np.mean([obj.matrix_world.translation for obj in items], 0)
        apart = np.array(context.scene.cursor.location) - middle
        copies = [copy_of(context, obj) for obj in items]
        for obj, copy in zip(items, copies, strict=True):
            copy.location = np.array(obj.location) + [apart[0], apart[1], 0.0]
        choose(context, *copies)


class UNISIM_OT_forget_static(EditsObjects, bpy.types.Operator):
    """Remove the marks of the selected static items; the scene itself stays unchanged"""

    bl_label = "Unmark Static Item"
    needs = (object_mode, selected("Select a static item first", "STATIC"))

    def edit(self, context: bpy.types.Context) -> None:
        for uid in {obj.unisim.uid for obj in chosen(context, "STATIC")}:
            forget_static(context.scene, uid)
