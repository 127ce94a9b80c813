"""Edits that are an object's scale."""

from __future__ import annotations

from typing import Any

import bpy

from ....editing.edits.lines import EditLine
from ....editing.sampled.source import DriveSource
from ...objects.animation import remove_curves
from ...window.refresh import refresh
from ..standing import scaled_to
from .carrier import Carrier, Edited, Muted, register


@register
class ScaleCarrier(Carrier):
    """An actor's scale."""

    name = "scale"

    def apply(self, obj: bpy.types.Object, edited: Edited) -> None:
        """Scale the object."""
        obj.scale = edited.actor.scale

    def mute(
        self, scene: bpy.types.Scene, source: DriveSource, item: Any, line: EditLine, obj: bpy.types.Object | None
    ) -> None:
        """Keep the factors."""
        assert obj is not None  # the line is of an object
        item.scale, item.scale_lift_m = obj.scale, obj.unisim.scale_lift_m
        self.revert(scene, source, line, obj)

    def unmute(self, scene: bpy.types.Scene, source: DriveSource, muted: Muted, now: bpy.types.Object | None) -> None:
        """Scale the object again."""
        assert now is not None  # a removal conflicts, and is muted by now
        scaled_to(now, muted.scale, muted.scale_lift_m)
        refresh([now])

    def revert(self, scene: bpy.types.Scene, source: DriveSource, line: EditLine, obj: bpy.types.Object | None) -> None:
        """Give the object the size that it was imported with."""
        assert obj is not None
        remove_curves(obj, "scale", "delta_scale")
        obj.delta_scale = (1.0, 1.0, 1.0)
        scaled_to(obj, (1.0, 1.0, 1.0), 0.0)
        refresh([obj])

    def keep(self, now: bpy.types.Object, parked: bpy.types.Object) -> None:
        """The actor's scale."""
        scaled_to(parked, now.scale, now.unisim.scale_lift_m)
