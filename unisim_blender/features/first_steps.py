"""First steps in the sidebar: import, look, edit, render. They go once all are done, and files that are past them have none."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..bridge.sampling.edit_list import reading_of
from ..bridge.window import run_soon
from ..editing.texts import translatable
from .edits import watch as edit_watch
from .output.operators import results_of
from .sidebar import Sidebar

STEPS = (
    ("VIEW", translatable("View: Show It Rendered"), "view3d.toggle_shading"),
    ("EDIT", translatable("Edit: Insert an Actor"), "unisim.insert_actor"),
    ("RENDER", translatable("Render: This Frame (F12)"), "render.render"),
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
        if context.scene.unisim.log:
            self.layout.prop(context.scene.unisim, "first_steps", text="", icon="X", emboss=False)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw a button for each step, ticked where it is done; in a file with other drives only the import."""
        about, column = context.scene.unisim, self.layout.column(align=True)
        icon = "CHECKBOX_HLT" if about.log else "IMPORT"
        column.operator("unisim.import_drive", text="Import a Drive", icon=icon)
        if not about.log and any(scene.unisim.log for scene in bpy.data.scenes):
            return
        done = done_steps(context) if about.log else set()
        column = column.column(align=True)
        column.enabled, column.operator_context = bool(about.log), "INVOKE_DEFAULT"
        for step, text, operator in STEPS:
            button = column.operator(operator, text=text, icon="CHECKBOX_HLT" if step in done else "CHECKBOX_DEHLT")
            if step == "VIEW":
                button.type = "RENDERED"


def done_steps(context: bpy.types.Context) -> set[str]:
    """Return the steps that are done, and have new ones noted."""
    scene, shading = context.scene, context.space_data.shading.type
    edit_watch.want()
    done = before = set(scene.unisim.done_steps.split())
    done = done | ({"VIEW"} if shading == "RENDERED" else set())
    done = done | ({"EDIT"} if reading_of(scene).active else set())
    done = done | ({"RENDER"} if scene.name in _rendered or results_of(scene) else set())
    if done != before:
        _new[:] = [(scene.name, done)]
        run_soon(note_steps)  # a panel may not write while it is drawn
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


HANDLERS = (("render_complete", note_render),)
TIMERS = (note_steps,)
