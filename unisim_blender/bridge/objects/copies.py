"""Copies of objects of the drive, as Shift-D makes them."""

from __future__ import annotations

import bpy


def copy_of(context: bpy.types.Context, source: bpy.types.Object) -> bpy.types.Object:
    """A copy in the same collections, with an action of its own and the same mesh."""
    copy = source.copy()
    copy_action(source, copy)
    for collection in source.users_collection:
        collection.objects.link(copy)
    if source.unisim.mesh:
        _copy_parts(context, source, copy)
    return copy


def copy_action(source: bpy.types.Object, copy: bpy.types.Object) -> None:
    """Give a copy of an object a copy of that one's action."""
    if copy.animation_data is None or copy.animation_data.action is None:
        return
    slot = getattr(source.animation_data, "action_slot", None)
    copy.animation_data.action = source.animation_data.action.copy()
    if slot is not None:
        copy.animation_data.action_slot = copy.animation_data.action.slots[slot.identifier]


def _copy_parts(context: bpy.types.Context, source: bpy.types.Object, copy: bpy.types.Object) -> None:
    """Give a copy its own copies of what is parented to its source: that is part of it."""
    for child in source.children:
        part = copy_of(context, child)
        part.parent = copy
        part.matrix_parent_inverse = child.matrix_parent_inverse  # setting the parent forgets it
        _copy_parts(context, child, part)
