"""What is selected."""

from __future__ import annotations

import bpy

from ...editing.texts import counted


def chosen(context: bpy.types.Context, *kinds: str) -> list[bpy.types.Object]:
    """The selected objects of some kinds."""
    return [thing for thing in context.selected_objects if thing.unisim.kind in kinds]


def counted_names(things: list[bpy.types.Object]) -> str:
    """Return the name of the only one of some actors, or how many there are: "3 actors"."""
    return things[0].name if len(things) == 1 else counted(len(things), "1 actor", "{count} actors")


def choose(context: bpy.types.Context, *things: bpy.types.Object) -> None:
    """Select these and nothing else, also in views that do not show what was selected; the last becomes active."""
    for other in list(context.view_layer.objects.selected):
        other.select_set(False)
    for thing in things:
        thing.select_set(True)
        context.view_layer.objects.active = thing
