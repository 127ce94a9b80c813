"""Panels of the sidebar's tab UniSim: their bases, the row that chooses between them by task, and rows of settings."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty

from ..process.background import is_own, newest, what_runs
from ..process.tasks import Task
from ..translations import interface, localized
from .problems import draw_problem, problem_button

TASKS = (
    ("VIEW", "View", "What was recorded, and what of it the views show"),
    ("EDIT", "Edit", "Actors, sensors and the ego vehicle, the list of edits and its check"),
    ("SIMULATE", "Simulate", "A driver in the closed loop, its rollouts and scores"),
    ("RENDER", "Render", "Sequences of images and sweeps, variants, batches, and training"),
)


class Sidebar:
    """A panel in the tab UniSim. ``tasks`` names those of `TASKS` that it belongs to; the parts of a panel are where that
    is."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "UniSim"
    tasks: tuple[str, ...] = ()

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Its task has to be chosen; without a drive there is no choice."""
        chosen = context.window_manager.unisim_panels
        return not cls.tasks or not context.scene.unisim.log or chosen in cls.tasks


class DrivePanel(Sidebar):
    """A panel that needs a drive."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there, and the panel's task chosen."""
        return bool(context.scene.unisim.log) and super().poll(context)


class UNISIM_PT_tasks(DrivePanel, bpy.types.Panel):
    """Which panels the tab has"""

    bl_label = "Task"
    bl_order = -1
    bl_options = {"HIDE_HEADER"}

    def draw(self, context: bpy.types.Context) -> None:
        self.layout.row(align=True).prop(context.window_manager, "unisim_panels", expand=True)


def settings_column(layout: Any, align: bool = False) -> Any:
    """Return a column whose properties have their names on the left."""
    column = layout.column(align=align)
    column.use_property_split, column.use_property_decorate = True, False
    return column


def row_of(layout: Any, name: str, text: str, icon: str = "NONE") -> None:
    """Draw a row that says ``text`` of ``name``; it stays where it is when there is nothing to say."""
    split = layout.split(factor=0.36)
    split.label(text=name, icon=icon)
    split.label(text=text or "–", translate=False)


def switch_of(member: str, first: Callable[[Any], float], name: str, description: str) -> Any:
    """Return a property that switches a number on and off, which is 0 while it is off, in files too; ``first`` returns the
    value that it has then."""

    def write(self: Any, value: bool) -> None:
        if value != bool(getattr(self, member)):
            setattr(self, member, first(self) if value else 0)

    return BoolProperty(
        name=name, description=description, get=lambda self: bool(getattr(self, member)), set=write, options=set()
    )


def optional_row(layout: Any, name: str, otherwise: str, owner: Any, switch: str, value: str) -> None:
    """Draw the switch of a setting, and beside it the value, or while it is off what holds ``otherwise``."""
    row = layout.row(align=True, heading=name)
    row.prop(owner, switch, text="")
    if getattr(owner, switch):
        row.prop(owner, value, text="")
    else:
        row.label(text=otherwise)


def text_row(layout: Any, otherwise: str, owner: Any, name: str) -> None:
    """Draw the field of a text, which says what holds while it is empty; before Blender 4.3 its tooltip says so."""
    layout.prop(owner, name, **({"placeholder": interface(otherwise)} if bpy.app.version >= (4, 3, 0) else {}))


def draw_task(layout: Any, scene: bpy.types.Scene, *kinds: type[Task]) -> None:
    """Draw how far a scene's newest task of some kinds is, and a cross that ends it, in a row that is always there; where
    it runs for another file or scene, for which."""
    begun = [newest[kind] for kind in kinds if kind in newest]
    task = max(begun, key=lambda one: (one.running, is_own(one, scene), one.started_s), default=None)
    own = task is not None and is_own(task, scene)
    row = layout.row(align=True)
    if task is not None and task.running and not own:
        row.label(text=localized(what_runs() or ""), translate=False)
    elif task is not None and own:
        row.progress(factor=task.fraction_shown, text=task.line)
    else:
        row.progress(factor=0.0, text=interface("No task"))
    cross = row.row(align=True)
    cross.enabled = task is not None and task.running
    cross.operator("unisim.cancel_task", text="", icon="CANCEL")
    if task is not None and own and task.problem:  # longer than a bar
        draw_problem(layout, task.problem)
        problem_button(layout, interface(task.title), task.problem, task.remedy, interface("Show Problem"))


PROPERTIES = (
    (
        bpy.types.WindowManager,
        "unisim_panels",
        EnumProperty(name="Task", description="Panels that the tab shows", items=TASKS, default="EDIT"),
    ),
)
