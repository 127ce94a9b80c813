"""Edits that are an object of their own: copies, inserted actors, bodies. A muted one is kept outside all scenes."""

from __future__ import annotations

from typing import Any

import bpy

from ....editing.edits.lines import EditLine
from ....editing.sampled.source import DriveSource
from ...importing.drive import fit_resolution, front_camera
from ...objects.imported import collection_of, copy_action
from ...objects.trajectories import remove, trajectory_of
from ...window import refresh
from .carrier import Carrier, Muted, register


@register
class ObjectCarrier(Carrier):
    """An object with its parts."""

    name = "own_object"

    def mute(
        self, scene: bpy.types.Scene, source: DriveSource, item: Any, line: EditLine, obj: bpy.types.Object | None
    ) -> None:
        """Take the object out of all collections; it stays in the file."""
        assert obj is not None  # the line is of an object
        item.parked = obj
        note_collection(scene, item, obj)
        if scene.camera == obj:
            scene.camera = None
            unlink(obj)
            scene.camera = front_camera(scene)
            fit_resolution(scene)
        for part in with_parts(obj):
            unlink(part)
            part.use_fake_user = part != obj  # a parent does not keep its parts in the file
        refresh([])

    def unmute(self, scene: bpy.types.Scene, source: DriveSource, muted: Muted, now: bpy.types.Object | None) -> None:
        assert muted.parked is not None
        for part in with_parts(muted.parked):
            (muted.collection or collection_of(scene, muted.kind)).objects.link(part)
            part.use_fake_user = False
        refresh([muted.parked])

    def revert(self, scene: bpy.types.Scene, source: DriveSource, line: EditLine, obj: bpy.types.Object | None) -> None:
        assert obj is not None
        delete(scene, obj)


def delete(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Delete an object with its parts; an active camera makes way for the one that looks ahead."""
    was_active = scene.camera == obj
    discard(obj)
    if was_active:
        scene.camera = front_camera(scene)
        fit_resolution(scene)


def with_parts(obj: bpy.types.Object) -> list[bpy.types.Object]:
    """Return an object and, of a mesh, its parts."""
    return [obj, *(obj.children_recursive if obj.unisim.mesh else ())]


def discard(obj: bpy.types.Object) -> None:
    """Delete an object, with its parts and its trajectory."""
    for part in with_parts(obj)[1:]:
        bpy.data.objects.remove(part)
    remove(obj)


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
