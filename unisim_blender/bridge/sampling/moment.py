"""One image or sweep as a request to the worker: the scenario of the moment, and what looks at it.

The scene is read at the frames next to the one that is shown, which is all that a shutter or a sweep can see of it, by
the very code that reads it for export.
"""

from __future__ import annotations

import bpy

from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import Sampled, SampledObject
from ...editing.sampled.source import DriveSource
from .stepping import SetFrame, sample


def moment(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    source: DriveSource,
    frame: float,
    set_frame: SetFrame,
    camera: bpy.types.Object,
) -> tuple[Sampled, SampledObject]:
    """The scene about ``frame``, and what ``camera`` is in it."""
    clock = Clock.of(source.drive).around(frame)
    sampled = sample(scene, depsgraph, clock, set_frame, also=[camera])
    return sampled, next(obj for obj in sampled.objects if obj.name == camera.name)
