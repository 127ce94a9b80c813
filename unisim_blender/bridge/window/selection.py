"""Selection of objects."""

from __future__ import annotations

import bpy

from ...editing.texts import counted


def chosen(context: bpy.types.Context, *kinds: str) -> list[bpy.types.Object]:
    """The selected objects of some kinds."""
    return [obj for obj in context.selected_objects if obj.unisim.kind in kinds]


def counted_names(objects: list[bpy.types.Object]) -> str:
    """Return the name of the only one of some actors, or how many there are: "3 actors"."""
    return objects[0].name if len(objects) == 1 else counted(len(objects), "1 actor", "{count} actors")


def choose(context: bpy.types.Context, *objects: bpy.types.Object) -> None:
    """Select these and nothing else, also in views that do not show what was selected; the last becomes active."""
    for other in list(context.view_layer.objects.selected):
        other.select_set(False)
    for obj in objects:
        obj.select_set(True)
        context.view_layer.objects.active = obj
