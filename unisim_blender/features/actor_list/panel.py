"""Panel Actors: the drive's actors as a list, filtered and sorted. Drawing reads what `listing` has worked out."""

import bpy

from ...editing.actors.table import dense, distance_text, speed_text, time_text
from ...editing.texts import kmh
from ...translations import interface, localized
from ..problems import draw_problem
from ..sidebar import DrivePanel
from . import listing
from .operators import ICONS

ROWS, NARROW_ROWS = 8, 5
"""Actors that the list shows at once, in a wide sidebar and in a narrow one."""
WIDE_PX = 340
"""From this width of the sidebar on, on an ordinary display, an actor takes one line; below it two, so
that all of it fits."""
NAME_FACTOR, DISTANCE_FACTOR, SPEED_FACTOR = 0.48, 0.28, 0.40
"""Widths of the columns of one line, each of what is left of it."""


def is_wide(context: bpy.types.Context) -> bool:
    """Return whether an actor takes one line."""
    return context.region is not None and context.region.width > WIDE_PX * context.preferences.system.ui_scale


def columns(layout: bpy.types.UILayout) -> tuple[bpy.types.UILayout, ...]:
    """Return the columns of a row: name, distance, speed, time, eye."""
    row = layout.row(align=True)
    split = row.split(factor=NAME_FACTOR)
    name = split.row(align=True)
    split = split.split(factor=DISTANCE_FACTOR)
    distance = split.row()
    split = split.split(factor=SPEED_FACTOR)
    parts = name, distance, split.row(), split.row(), row.row()
    for column in parts[1:4]:
        column.alignment = "RIGHT"
    return parts


class UNISIM_UL_actors(bpy.types.UIList):
    """Actors of a drive"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0):  # type: ignore[no-untyped-def]
        """Draw one row; what is not worked out yet is a dash."""
        entry = listing.table_of(context.scene).entries.get(item.session_uid)
        if entry is None:
            layout.label(text=item.name, icon="BLANK1")
            return
        text, icon = item.name + (" *" if entry.edited else ""), ICONS[entry.group]
        if is_wide(context):
            name, *parts, eye = columns(layout)
            for part, value in zip(parts, (distance_text(entry), speed_text(entry), time_text(entry)), strict=True):
                part.active = entry.there and not entry.hidden
                part.label(text=localized(value), translate=False)
            name.active = entry.there and not entry.hidden
            name.label(text=text, icon=icon)
        else:
            row = layout.row(align=True)
            column, eye = row.column(align=True), row.row()
            column.active = entry.there and not entry.hidden
            column.scale_y = 0.9
            column.label(text=text, icon=icon)
            line = f"{distance_text(entry)} m, {kmh(entry.speed_m_s)}" if entry.there else interface("not there now")
            below = column.row()  # Blender takes a click on a list's row in its first line alone
            below.alignment = "LEFT"
            time = interface("{time} s", time=time_text(entry))
            text = f"{line}, {time}"
            line_button = below.operator("unisim.choose_actor", text=text, translate=False, icon="BLANK1", emboss=False)
            line_button.name = item.name
        hide = eye.operator("unisim.hide_actor", text="", icon="HIDE_ON" if entry.hidden else "HIDE_OFF", emboss=False)
        hide.name = item.name

    def filter_items(self, context, data, property):  # type: ignore[no-untyped-def]
        """Show the actors that the filter lets through, in its order; the scene's other objects are no rows."""
        objects = getattr(data, property)
        ranks = {entry.key: rank for rank, entry in enumerate(listing.table_of(context.scene).shown)}
        keys = [obj.session_uid for obj in objects]
        flags = [self.bitflag_filter_item if key in ranks else 0 for key in keys]
        # positions have to be a permutation: of entries whose object is gone the rank is free
        return flags, dense([ranks.get(key, len(ranks) + place) for place, key in enumerate(keys)])

    def draw_filter(self, context, layout):  # type: ignore[no-untyped-def]
        """The panel has the filter, always open."""
        layout.label(text="The filter is above the list")


class UNISIM_PT_actors(DrivePanel, bpy.types.Panel):
    """All actors of the drive, with copies and inserted ones"""

    bl_label = "Actors"
    bl_order = 2
    tasks = ("VIEW", "EDIT")
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene, wanted = self.layout, context.scene, context.window_manager.unisim_actors
        table = listing.table_of(scene)
        if table.problem:
            draw_problem(layout, localized(table.problem), "ERROR")
        row = layout.row(align=True)
        row.prop(wanted, "text", text="", icon="VIEWZOOM")
        row.operator("unisim.clear_actor_filter", text="", icon="X")
        row = layout.row(align=True)
        row.prop(wanted, "group", text="")
        near = row.row(align=True)
        near.prop(wanted, "is_near", text="")
        if wanted.is_near:
            near.prop(wanted, "within_m")
        else:
            near.label(text="Any Distance")
        row = layout.row(align=True)
        row.prop(wanted, "now", toggle=True)
        row.prop(wanted, "edited", toggle=True)
        row.prop(wanted, "order", text="")
        head, wide = layout.column(align=True), is_wide(context)
        count = interface("{number} of {count}", number=len(table.shown), count=len(table.entries))
        if wide:
            for part, text in zip(columns(head), (count, "m", "km/h", "s", ""), strict=True):
                part.active = False
                part.label(text=text, icon="NONE" if text else "BLANK1")
        else:
            head.label(text=count)
        rows = ROWS if wide else NARROW_ROWS
        head.template_list("UNISIM_UL_actors", "", scene, "objects", wanted, "place", rows=rows, maxrows=rows)
        row = layout.row(align=True)
        row.prop(wanted, "jump", toggle=True)
        row.prop(wanted, "frame", toggle=True)
        layout.operator("unisim.select_listed", icon="RESTRICT_SELECT_OFF")
