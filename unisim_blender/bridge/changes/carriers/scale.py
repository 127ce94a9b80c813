"""Edits that are an object's scale. An actor that is scaled keeps its underside where it was: its wheels stay on the road.

Blender scales about an object's origin, the middle of its box. The object is displaced along its own axis afterwards,
and the displacement is noted on it: it goes with the scale, and `stand` makes it up again after redo."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import bpy
import numpy as np

from ....editing.edits.lines import EditLine
from ....editing.sampled.scene import SAME_SCALE
from ....editing.sampled.source import DriveSource
from ...objects.animation import remove_curves, scale_changes
from ...objects.meshes import corners_of, extent_of, within
from ...window import refresh
from ..motion import displaced_along
from .carrier import Carrier, Edited, Muted, register

UNKNOWN_SCALE = (0.0, 0.0, 0.0)
"""The noted scale of an object that none was noted of, as in files of earlier versions."""
SAME_RISE_M = 1e-3
"""Heights that differ by less are the same."""


def stand(obj: bpy.types.Object) -> bool:
    """Displace an actor that was scaled since its scale was noted, so that its underside is where it was; return
    whether it was scaled. A scale that was never noted is noted as it is."""
    about, now = obj.unisim, tuple(obj.scale)
    before = tuple(about.rest_scale)
    if before == UNKNOWN_SCALE:
        about.rest_scale = now
        return False
    if now == before:
        return False
    if min(now) > 0 and not scale_changes(obj):  # no other can be rendered
        as_imported = abs(now[2] - 1) < SAME_SCALE
        lift_m = 0.0 if as_imported else about.scale_lift_m + _rise(obj, now[2]) - _rise(obj, before[2])
        scaled_to(obj, now, lift_m)
    return True


def scaled_to(obj: bpy.types.Object, scale: Sequence[float], lift_m: float) -> None:
    """Give an actor a scale (3,) for which it is lifted by ``lift_m`` along its own axis, in place of what
    it was lifted by."""
    about = obj.unisim
    if lift_m != about.scale_lift_m:
        displaced_along(obj, (0.0, 0.0, lift_m - about.scale_lift_m))
    obj.scale = scale
    about.rest_scale, about.scale_lift_m = scale, lift_m


def note_scale(obj: bpy.types.Object, risen_m: float) -> None:
    """Note the scale of an actor that stands ``risen_m`` higher than it was recorded, along its own axis: where that is
    what its scale asks for, it was lifted for it."""
    rise_m = _rise(obj, obj.scale[2])
    obj.unisim.rest_scale = obj.scale
    obj.unisim.scale_lift_m = rise_m if abs(risen_m - rise_m) < SAME_RISE_M else 0.0


def give_box(obj: bpy.types.Object, mesh: bpy.types.Mesh, height_m: float) -> None:
    """Give an actor another box of a height; its underside stays where it is."""
    taller_m, factor = height_m - float(extent_of(obj)[2]), float(obj.scale[2])
    obj.data = mesh
    displaced_along(obj, (0.0, 0.0, factor * taller_m / 2))
    obj.unisim.scale_lift_m += (factor - 1) * taller_m / 2


def _rise(obj: bpy.types.Object, factor: float) -> float:
    """Return how far an actor has to be lifted, in metres along its own axis, for a factor of its height."""
    if obj.unisim.mesh:  # as it is scaled now, with all its parts
        low = float(corners_of(obj, lambda part: within(part, obj))[:, 2].min(initial=0.0)) / float(obj.scale[2])
    else:
        low = float(np.array(obj.bound_box)[:, 2].min())
    return -low * (factor - 1)


@register
class ScaleCarrier(Carrier):
    """An actor's scale."""

    name = "scale"

    def apply(self, obj: bpy.types.Object, edited: Edited) -> None:
        obj.scale = edited.actor.scale

    def mute(
        self, scene: bpy.types.Scene, source: DriveSource, item: Any, line: EditLine, obj: bpy.types.Object | None
    ) -> None:
        assert obj is not None  # the line is of an object
        item.scale, item.scale_lift_m = obj.scale, obj.unisim.scale_lift_m
        self.revert(scene, source, line, obj)

    def unmute(self, scene: bpy.types.Scene, source: DriveSource, muted: Muted, now: bpy.types.Object | None) -> None:
        assert now is not None  # a removal conflicts, and is muted by now
        scaled_to(now, muted.scale, muted.scale_lift_m)
        refresh([now])

    def revert(self, scene: bpy.types.Scene, source: DriveSource, line: EditLine, obj: bpy.types.Object | None) -> None:
        assert obj is not None
        remove_curves(obj, "scale", "delta_scale")
        obj.delta_scale = (1.0, 1.0, 1.0)
        scaled_to(obj, (1.0, 1.0, 1.0), 0.0)
        refresh([obj])

    def keep(self, now: bpy.types.Object, parked: bpy.types.Object) -> None:
        scaled_to(parked, now.scale, now.unisim.scale_lift_m)
