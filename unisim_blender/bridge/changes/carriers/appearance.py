"""Edits that are an actor's appearance, which its object notes by name."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ....core.world.drive import Drive
from ....editing.edits.lines import EditLine
from ....editing.sampled.source import DriveSource, scene_actors
from ...objects.imported import box_mesh
from ...objects.meshes import extent_of
from ...objects.trajectories import trajectory_of
from ...window import refresh
from ..motion import displaced_along
from .carrier import Carrier, Edited, Muted, register
from .scale import give_box


@register
class AppearanceCarrier(Carrier):
    """An actor's appearance."""

    name = "appearance"

    def apply(self, obj: bpy.types.Object, edited: Edited) -> None:
        actor = edited.actor
        if edited.own_appearance is None or (actor.appearance.actor, actor.appearance.scene) == (
            edited.own_appearance,
            "",
        ):
            return
        obj.unisim.look, obj.unisim.look_scene = actor.appearance.actor, actor.appearance.scene
        obj.data = box_mesh(actor.appearance_size_m, actor.label)

    def mute(
        self, scene: bpy.types.Scene, source: DriveSource, item: Any, line: EditLine, obj: bpy.types.Object | None
    ) -> None:
        assert obj is not None  # the line is of an object
        item.look, item.look_scene = obj.unisim.look, obj.unisim.look_scene
        self.revert(scene, source, line, obj)

    def unmute(self, scene: bpy.types.Scene, source: DriveSource, muted: Muted, now: bpy.types.Object | None) -> None:
        assert now is not None  # a removal conflicts, and is muted by now
        set_appearance(now, source.drive, muted.look, muted.look_scene)
        refresh([now])

    def revert(self, scene: bpy.types.Scene, source: DriveSource, line: EditLine, obj: bpy.types.Object | None) -> None:
        assert obj is not None
        set_appearance(obj, source.drive, "", "")
        refresh([obj])

    def keep(self, now: bpy.types.Object, parked: bpy.types.Object) -> None:
        if (now.unisim.look, now.unisim.look_scene) == (parked.unisim.look, parked.unisim.look_scene):
            return
        rise = (float(extent_of(now)[2]) - float(extent_of(parked)[2])) / 2
        parked.unisim.look, parked.unisim.look_scene, parked.data = now.unisim.look, now.unisim.look_scene, now.data
        lift(parked, rise)


def set_appearance(obj: bpy.types.Object, drive: Drive, appearance: str, scene: str) -> None:
    """Give an actor the appearance of another one, "" for its own: that one's box, on the same ground."""
    named = appearance or obj.unisim.uid
    actor = (scene_actors(Path(bpy.path.abspath(scene))) if scene else drive.actors)[named]
    obj.unisim.look, obj.unisim.look_scene = appearance, scene
    give_box(obj, box_mesh(actor.size_m, actor.label), float(actor.size_m[2]))


def lift(obj: bpy.types.Object, up_m: float) -> None:
    """Displace an object upwards along its own axes; that is no change that a person made."""
    if up_m == 0.0:
        return
    displaced_along(obj, (0.0, 0.0, up_m))
    if trajectory_of(obj) is not None:
        obj.unisim.rest_location = obj.location
