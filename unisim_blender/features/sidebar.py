"""Bases and rows of the panels in the sidebar's tab UniSim."""

from __future__ import annotations

from typing import Any

import bpy


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
