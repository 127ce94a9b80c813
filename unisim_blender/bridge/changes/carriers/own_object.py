"""Edits that are an object of their own: copies, inserted actors, bodies. A muted one is kept outside all scenes."""

from __future__ import annotations

from typing import Any

import bpy

from ....editing.edits.lines import EditLine
from ....editing.sampled.source import DriveSource
from ...importing.drive import fit_resolution, front_camera
from ...objects.imported import collection_of
from ...objects.trajectories import remove
from ...window.refresh import refresh
from .carrier import Carrier, Muted, register
from .parking import note_collection, unlink, with_parts


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
        for one in with_parts(obj):
            unlink(one)
            one.use_fake_user = one != obj  # a parent does not keep its parts in the file
        refresh([])

    def unmute(self, scene: bpy.types.Scene, source: DriveSource, muted: Muted, now: bpy.types.Object | None) -> None:
        """Put the object where it stood."""
        assert muted.parked is not None
        for one in with_parts(muted.parked):
            (muted.collection or collection_of(scene, muted.kind)).objects.link(one)
            one.use_fake_user = False
        refresh([muted.parked])

    def revert(self, scene: bpy.types.Scene, source: DriveSource, line: EditLine, obj: bpy.types.Object | None) -> None:
        """Delete the object."""
        assert obj is not None
        delete(scene, obj)


def delete(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Delete an object with its parts; an active camera makes way for the one that looks ahead."""
    was_active = scene.camera == obj
    for part in with_parts(obj)[1:]:
        bpy.data.objects.remove(part)
    remove(obj)
    if was_active:
        scene.camera = front_camera(scene)
        fit_resolution(scene)
