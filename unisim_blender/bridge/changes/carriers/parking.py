"""Objects that are kept outside all scenes while their edits are muted."""

from __future__ import annotations

from typing import Any

import bpy

from ...objects.copies import copy_action
from ...objects.trajectories import remove, trajectory_of


def with_parts(thing: bpy.types.Object) -> list[bpy.types.Object]:
    """Return an object and, of a mesh, its parts."""
    return [thing, *(thing.children_recursive if thing.unisim.mesh else ())]


def discard(parked: bpy.types.Object) -> None:
    """Delete an object that is in no scene, with its parts and its trajectory."""
    for part in with_parts(parked)[1:]:
        bpy.data.objects.remove(part)
    remove(parked)


def note_collection(scene: bpy.types.Scene, item: Any, thing: bpy.types.Object) -> None:
    """Note which collection an object is in. Blender keeps no pointer to a scene's own one."""
    collection = next(iter(thing.users_collection), None)
    item.at_root = collection == scene.collection
    item.collection = None if item.at_root else collection


def parked_copy(thing: bpy.types.Object, name: str) -> bpy.types.Object:
    """Return a copy of an object that is in no scene, with keys and a trajectory of its own."""
    copy = thing.copy()
    copy.name = name
    copy_action(thing, copy)
    above = trajectory_of(thing)
    if above is not None:
        inverse = thing.matrix_parent_inverse.copy()
        copy.parent = above.copy()
        copy.parent.name = f"{name} trajectory"
        copy.matrix_parent_inverse = inverse
        copy_action(above, copy.parent)
        copy.parent.use_fake_user = True  # being a parent keeps nothing in the file
    if thing.type == "CAMERA":
        copy.data = thing.data.copy()
    return copy


def unlink(thing: bpy.types.Object) -> None:
    """Take an object out of all collections."""
    for collection in list(thing.users_collection):
        collection.objects.unlink(thing)
