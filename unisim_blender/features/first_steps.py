"""First steps in the sidebar: import, look, edit, render. They go once all are done, and files that are past them have none."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..bridge.sampling.edit_list import reading_of
from ..editing.texts import translatable
from .edits import watch as edit_watch
from .output.operators import results_of
from .sidebar import Sidebar

STEPS = (
    ("VIEW", translatable("View: Show It Rendered"), "unisim.show_rendered"),
    ("EDIT", translatable("Edit: Insert an Actor"), "unisim.insert_actor"),
    ("RENDER", translatable("Render: This Frame (F12)"), "unisim.render_frame"),
)
_rendered: set[str] = set()
"""Scenes of which an image was rendered since Blender started, by name."""


class UNISIM_PT_first_steps(Sidebar, bpy.types.Panel):
    """Import a drive, look at it, edit it, and render it"""

    bl_label = "First Steps"
    bl_order = 0

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """The scene has no drive, or steps are left in the file of a first drive."""
        return not context.scene.unisim.log or context.scene.unisim.first_steps

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Draw what hides the steps."""
        if context.scene.unisim.log:
            self.layout.operator("unisim.hide_first_steps", text="", icon="X", emboss=False)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a button for each step, ticked where it is done; in a file with other drives only the import."""
        about, column = context.scene.unisim, self.layout.column(align=True)
        row = column.row(align=True)
        row.operator("unisim.import_drive", text="Import a Drive", icon="CHECKBOX_HLT" if about.log else "IMPORT")
        if not about.log and any(scene.unisim.log for scene in bpy.data.scenes):
            return
        done = done_steps(context) if about.log else set()
        for step, text, operator in STEPS:
            row = column.row(align=True)
            row.enabled = bool(about.log)
            row.operator(operator, text=text, icon="CHECKBOX_HLT" if step in done else "CHECKBOX_DEHLT")


def done_steps(context: bpy.types.Context) -> set[str]:
    """Return the steps that are done, and have new ones noted."""
    scene = context.scene
    edit_watch.want()
    now = {
        "VIEW": context.space_data.shading.type == "RENDERED",
        "EDIT": bool(reading_of(scene).active),
        "RENDER": scene.name in _rendered or bool(results_of(scene)),
    }
    before = set(scene.unisim.done_steps.split())
    done = before | {step for step, is_done in now.items() if is_done}
    if done != before and not bpy.app.timers.is_registered(note_steps):
        _new[:] = [(scene.name, done)]
        bpy.app.timers.register(note_steps, first_interval=0.0)  # a panel may not write while it is drawn
    return done


_new: list[tuple[str, set[str]]] = []
"""The scene whose steps are to be noted."""


def note_steps() -> None:
    """Note the steps that are done; hide them where all are."""
    for name, done in _new:
        if name in bpy.data.scenes:
            about = bpy.data.scenes[name].unisim
            about.done_steps, about.first_steps = " ".join(sorted(done)), len(done) < len(STEPS)
    _new.clear()


@persistent
def note_render(scene: bpy.types.Scene, *_: object) -> None:
    """Note that an image was rendered."""
    _rendered.add(scene.name)


class UNISIM_OT_show_rendered(bpy.types.Operator):
    """Show the drive as it is rendered: Rendered shading in this view"""

    bl_idname = "unisim.show_rendered"
    bl_label = "Show Rendered"
    bl_options = {"INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Change the shading of the view."""
        context.space_data.shading.type = "RENDERED"
        return {"FINISHED"}


class UNISIM_OT_render_frame(bpy.types.Operator):
    """Render the current frame through the active camera, as F12"""

    bl_idname = "unisim.render_frame"
    bl_label = "Render Frame"
    bl_options = {"INTERNAL"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Call Blender's own operator."""
        return {"FINISHED"} if bpy.ops.render.render("INVOKE_DEFAULT") != {"CANCELLED"} else {"CANCELLED"}


class UNISIM_OT_hide_first_steps(bpy.types.Operator):
    """Hide the first steps in this file"""

    bl_idname = "unisim.hide_first_steps"
    bl_label = "Hide First Steps"
    bl_options = {"INTERNAL", "UNDO"}

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Note that nobody wants them."""
        context.scene.unisim.first_steps = False
        return {"FINISHED"}


CLASSES = (UNISIM_PT_first_steps, UNISIM_OT_show_rendered, UNISIM_OT_render_frame, UNISIM_OT_hide_first_steps)
HANDLERS = (("render_complete", note_render),)
TIMERS = (note_steps,)
