"""Panel Actors: the drive's actors as a list, filtered and sorted. Drawing reads what `listing` has worked out."""

import bpy

from .. import listing
from ..operators.actor_list import ICONS
from .sidebar import DrivePanel

ROWS = 6
NAME_FACTOR, DISTANCE_FACTOR, SPEED_FACTOR = 0.53, 0.26, 0.36
"""Widths of the columns, each of what is left of the row."""
WIDE_PX = 340
"""From this width of the sidebar on, on an ordinary display, times have a digit after the point."""
SHORT_S = 5.0
"""They have it in any case where the drive is shorter than this."""


def columns(layout: bpy.types.UILayout) -> tuple[bpy.types.UILayout, ...]:
    """Return the columns of a row: name, distance, speed, time, eye."""
    row = layout.row(align=True)
    split = row.split(factor=NAME_FACTOR)
    name = split.row(align=True)
    split = split.split(factor=DISTANCE_FACTOR)
    distance = split.row()
    split = split.split(factor=SPEED_FACTOR)
    return name, distance, split.row(), split.row(), row.row()


def seconds(present_s: tuple[float, float] | None, exact: bool) -> str:
    """Return from when to when an actor is there, in seconds; rows are narrow."""
    if present_s is None:
        return "never"
    return "–".join(f"{time_s:.1f}".removesuffix(".0") if exact else f"{time_s:.0f}" for time_s in present_s)


def exact_times(context: bpy.types.Context) -> bool:
    """Return whether times have a digit after the point."""
    clock = listing.table_of(context.scene).clock
    short = clock is not None and clock.times_s[-1] - clock.times_s[0] < SHORT_S
    return short or context.region.width > WIDE_PX * context.preferences.system.ui_scale


class UNISIM_UL_actors(bpy.types.UIList):
    """Actors of a drive"""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0):  # type: ignore[no-untyped-def]
        """Draw one row; what is not worked out yet is a dash."""
        entry = listing.table_of(context.scene).entries.get(item.session_uid)
        name, distance, speed, time, eye = columns(layout)
        if entry is None:
            name.label(text=item.name, icon="BLANK1")
            return
        for part in (name, distance, speed, time):
            part.active = entry.there and not entry.hidden
            part.alignment = "RIGHT" if part is not name else "EXPAND"
        name.label(text=item.name + (" *" if entry.edited else ""), icon=ICONS[entry.group])
        distance.label(text=f"{entry.distance_m:.0f}" if entry.there else "–")
        speed.label(text=f"{entry.speed_m_s * 3.6:.0f}" if entry.there else "–")
        time.label(text=seconds(entry.present_s, exact_times(context)))
        hide = eye.operator("unisim.hide_actor", text="", icon="HIDE_ON" if entry.hidden else "HIDE_OFF", emboss=False)
        hide.name = item.name

    def filter_items(self, context, data, property):  # type: ignore[no-untyped-def]
        """Show the actors that the filter lets through, in its order; the scene's other objects are no rows."""
        objects = getattr(data, property)
        ranks = {entry.key: rank for rank, entry in enumerate(listing.table_of(context.scene).shown)}
        keys = [thing.session_uid for thing in objects]
        flags = [self.bitflag_filter_item if key in ranks else 0 for key in keys]
        order, rest = [], len(ranks)
        for key in keys:
            if key in ranks:
                order.append(ranks[key])
            else:
                order.append(rest)
                rest += 1
        # of entries whose object is gone the rank is free: positions have to be a permutation
        if rest != len(keys):
            order = dense(order)
        return flags, order

    def draw_filter(self, context, layout):  # type: ignore[no-untyped-def]
        """The panel has the filter, always open."""
        layout.label(text="The filter is above the list")


def dense(order: list[int]) -> list[int]:
    """Return ranks without gaps, in the same order."""
    places = {rank: place for place, rank in enumerate(sorted(order))}
    return [places[rank] for rank in order]


class UNISIM_PT_actors(DrivePanel, bpy.types.Panel):
    """All actors of the drive, with copies and inserted ones"""

    bl_label = "Actors"
    bl_order = 1

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the filter, the list, and what a click does."""
        layout, scene, wanted = self.layout, context.scene, context.window_manager.unisim_actors
        table = listing.table_of(scene)
        if table.problem:
            layout.label(text=table.problem, icon="ERROR")
        row = layout.row(align=True)
        row.prop(wanted, "text", text="", icon="VIEWZOOM")
        row.operator("unisim.clear_actor_filter", text="", icon="X")
        row = layout.row(align=True)
        row.prop(wanted, "group", text="")
        row.prop(wanted, "within_m")
        row = layout.row(align=True)
        row.prop(wanted, "now", toggle=True)
        row.prop(wanted, "edited", toggle=True)
        row.prop(wanted, "order", text="")
        head = layout.column(align=True)
        name, distance, speed, time, _ = columns(head)
        for part, text in ((name, f"{len(table.shown)} of {len(table.entries)}"), (distance, "m"), (speed, "km/h"), (time, "s")):
            part.active = False
            part.alignment = "RIGHT" if part is not name else "EXPAND"
            part.label(text=text)
        head.template_list("UNISIM_UL_actors", "", scene, "objects", wanted, "place", rows=ROWS, maxrows=ROWS)
        row = layout.row(align=True)
        row.prop(wanted, "jump", toggle=True)
        row.prop(wanted, "frame", toggle=True)
        layout.operator("unisim.select_listed", icon="RESTRICT_SELECT_OFF")


CLASSES = (UNISIM_UL_actors, UNISIM_PT_actors)
