"""What is selected."""

from __future__ import annotations

import bpy


def chosen(context: bpy.types.Context, *kinds: str) -> list[bpy.types.Object]:
    """The selected objects of some kinds."""
    return [thing for thing in context.selected_objects if thing.unisim.kind in kinds]


def choose(context: bpy.types.Context, *things: bpy.types.Object) -> None:
    """Select these and nothing else; the last becomes active."""
    for other in context.selected_objects:
        other.select_set(False)
    for thing in things:
        thing.select_set(True)
        context.view_layer.objects.active = thing
