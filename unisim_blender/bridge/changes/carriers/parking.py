"""Objects that are kept outside all scenes while their edits are muted."""

from __future__ import annotations

from typing import Any

import bpy

from ...objects.copies import copy_action
from ...objects.trajectories import remove, trajectory_of


def with_parts(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return an object and, of a mesh, its parts."""
    return [obj, *(obj.children_recursive if obj.unisim.mesh else ())]


def discard(parked: bpy.types.Object) -> None:
    """Delete an object that is in no scene, with its parts and its trajectory."""
    for part in with_parts(parked)[1:]:
        bpy.data.objects.remove(part)
    remove(parked)


def note_collection(scene: bpy.types.Scene, item: Any, obj: bpy.types.Object) -> None:
    """Note which collection an object is in. Blender keeps no pointer to a scene's own one."""
    collection = next(iter(obj.users_collection), None)
    item.at_root = collection == scene.collection
    item.collection = None if item.at_root else collection


def parked_copy(obj: bpy.types.Object, name: str) -> bpy.types.Object:
    """Return a copy of an object that is in no scene, with keys and a trajectory of its own."""
    copy = obj.copy()
    copy.name = name
    copy_action(obj, copy)
    above = trajectory_of(obj)
    if above is not None:
        inverse = obj.matrix_parent_inverse.copy()
        copy.parent = above.copy()
        copy.parent.name = f"{name} trajectory"
        copy.matrix_parent_inverse = inverse
        copy_action(above, copy.parent)
        copy.parent.use_fake_user = True  # being a parent keeps nothing in the file
    if obj.type == "CAMERA":
        copy.data = obj.data.copy()
    return copy


def unlink(obj: bpy.types.Object) -> None:
    """Take an object out of all collections."""
    for collection in list(obj.users_collection):
        collection.objects.unlink(obj)
