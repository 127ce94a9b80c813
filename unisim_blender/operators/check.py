"""What is not plausible about the edits, as a list."""

import bpy
from bpy.props import IntProperty, StringProperty

from ..bridge.clock import Clock
from ..bridge.plausibility import warnings_of
from ..bridge.sampling import sample_all
from ..bridge.selection import choose
from ..bridge.source import source_of
from ..core.errors import UnisimError
from .motion_settings import limits_of
from .polling import allowed, drive


class UNISIM_OT_check(bpy.types.Operator):
    """Look for edits that are not plausible: overlaps, cars sideways or too fast, actors off the ground, views from far away"""

    bl_idname = "unisim.check"
    bl_label = "Check Edits"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return allowed(cls, drive(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Sample the scene and list what is odd; nothing is kept from being rendered."""
        scene, found = context.scene, context.window_manager.unisim_warnings
        try:
            drive = source_of(scene).drive
            warnings = list(warnings_of(sample_all(scene, Clock.of(drive)), drive, limits_of(scene)))
        except (UnisimError, OSError) as fault:
            self.report({"ERROR"}, str(fault))
            return {"CANCELLED"}
        found.clear()
        for warning in warnings:
            item = found.add()
            item.name, item.frame, item.text = warning.name, warning.frame, warning.text
        self.report({"INFO"}, f"{len(warnings)} warnings" if warnings else "Nothing odd was found")
        return {"FINISHED"}


class UNISIM_OT_go_to(bpy.types.Operator):
    """Go to the frame and select the object that a warning is about"""

    bl_idname = "unisim.go_to"
    bl_label = "Go There"
    bl_options = {"REGISTER", "UNDO"}

    thing: StringProperty()
    frame: IntProperty()

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Frame, selection, and the view."""
        context.scene.frame_set(self.frame)
        thing = context.scene.objects.get(self.thing)
        if thing is None:
            self.report({"WARNING"}, f"{self.thing} is not there any more")
            return {"CANCELLED"}
        choose(context, thing)
        if context.area is not None and context.area.type == "VIEW_3D" and bpy.ops.view3d.view_selected.poll():
            bpy.ops.view3d.view_selected()
        return {"FINISHED"}


CLASSES = (UNISIM_OT_check, UNISIM_OT_go_to)
