"""Objects without annotation: a box of space marked as an item, which can then be moved, copied and deleted."""

import bpy
import numpy as np
from bpy.props import FloatVectorProperty

from ...bridge.objects.copies import copy_of
from ...bridge.objects.static_items import forget, mark
from ...bridge.window.polling import allowed, drive, object_mode, selected
from ...bridge.window.selection import choose, chosen
from ...editing.sampled.poses import rigid


class UNISIM_OT_mark_static(bpy.types.Operator):
    """Mark a static item: the bounding box of the selected active mesh, or a new box at the 3D cursor"""

    bl_idname = "unisim.mark_static"
    bl_label = "Mark Static Item"
    bl_options = {"REGISTER", "UNDO"}

    size_m: FloatVectorProperty(
        name="Size",
        description="Size of the new box",
        default=(0.6, 0.6, 1.0),
        min=0.02,
        subtype="XYZ_LENGTH",
        unit="LENGTH",
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return allowed(cls, object_mode(context), drive(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Take the mesh's place, or the cursor's."""
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
        obj = mark(context.scene, pose, size)
        choose(context, obj)
        return {"FINISHED"}


class UNISIM_OT_copy_static(bpy.types.Operator):
    """Copy the selected static items to the 3D cursor"""

    bl_idname = "unisim.copy_static"
    bl_label = "Copy Static Item"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A static item has to be selected."""
        return allowed(cls, object_mode(context), selected(context, "Select a static item first", "STATIC"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Several keep their places to each other."""
        items = chosen(context, "STATIC")
        middle = np.mean([obj.matrix_world.translation for obj in items], 0)
        apart = np.array(context.scene.cursor.location) - middle
        copies = [copy_of(context, obj) for obj in items]
        for obj, copy in zip(items, copies, strict=True):
            copy.location = np.array(obj.location) + [apart[0], apart[1], 0.0]
        choose(context, *copies)
        return {"FINISHED"}


class UNISIM_OT_forget_static(bpy.types.Operator):
    """Remove the marks of the selected static items; the scene itself stays unchanged"""

    bl_idname = "unisim.forget_static"
    bl_label = "Unmark Static Item"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A static item has to be selected."""
        return allowed(cls, object_mode(context), selected(context, "Select a static item first", "STATIC"))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """With all copies of each."""
        for uid in {obj.unisim.uid for obj in chosen(context, "STATIC")}:
            forget(context.scene, uid)
        return {"FINISHED"}


CLASSES = (UNISIM_OT_mark_static, UNISIM_OT_copy_static, UNISIM_OT_forget_static)
