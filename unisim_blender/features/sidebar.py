"""Bases and rows of the panels in the sidebar's tab UniSim."""

from __future__ import annotations

import textwrap
from typing import Any

import bpy

from ..process.background import is_own, newest, what_runs
from ..process.tasks import Task
from ..translations import interface, localized

PROBLEM_WIDTH = 40
"""Of a line of the panel at its first width, in letters."""


class Sidebar:
    """A panel in the tab UniSim."""

    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "UniSim"


class DrivePanel(Sidebar):
    """A panel that needs a drive."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """A drive has to be there."""
        return bool(context.scene.unisim.log)


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
        lines = layout.column(align=True)
        for line in textwrap.wrap(task.problem, PROBLEM_WIDTH):
            lines.label(text=line, translate=False)
