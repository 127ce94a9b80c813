"""A scenario's edits carried out on the objects of an imported scene, by their kinds: the other
direction of readers."""

from __future__ import annotations

import math
from collections.abc import Iterator

import bpy
import numpy as np

from ....core.scenario.types import FrameRange, Scenario
from ....core.world.drive import Drive
from ....editing.reading.scenario import names_captures, span_s, stated_text
from ....editing.sampled.clock import Clock
from ....editing.sampled.source import DriveSource
from ...objects.simulation import apply_simulation
from .actors import apply_actors
from .ego import apply_bodies, apply_ego
from .sensors import apply_sensors
from .static_items import apply_static
from .target import Target

APPLIED = (apply_static, apply_bodies, apply_ego, apply_sensors)
"""In this order, after actors: sensors are put where the edited vehicle is."""


def apply_edits(scene: bpy.types.Scene, source: DriveSource, scenario: Scenario, edited: Drive) -> Iterator[None]:
    """Make a freshly imported scene stand for ``scenario``, whose edits lead to the drive ``edited``, a step of some
    milliseconds at a time."""
    target = Target(scene, source.drive, scenario, edited, Clock.of(source.drive))
    yield from apply_actors(target)
    for applied in APPLIED:
        applied(target)
        yield
    _apply_settings(target)


def _apply_settings(target: Target) -> None:
    """Give the scene the scenario's frames and outputs, and let it keep what no object stands for."""
    scene, frames, outputs = target.scene, target.scenario.frames, target.scenario.outputs
    if isinstance(frames, FrameRange):
        scene.frame_start, scene.frame_end = target.edited.frames[0], target.edited.frames[-1]
        scene.frame_step = frames.step or 1
    elif frames:
        scene.frame_start, scene.frame_end = min(frames), max(frames)
    elif (span := span_s(target.scenario, target.edited)) is not None:
        first, last = target.clock.frame(np.array(span))
        scene.frame_start, scene.frame_end = max(0, math.floor(first)), math.ceil(last)
    scene.unisim.stated = stated_text(target.scenario)
    apply_simulation(scene, target.scenario.simulation)
    if names_captures(scene.unisim.stated):
        scene.unisim.stated_range = (scene.frame_start, scene.frame_end, scene.frame_step)
    if outputs is not None:
        scene.unisim.passes = set(outputs.passes or ()) - {"rgb"}
        scene.unisim.quality = outputs.quality or "balanced"
        scene.unisim.contact_shadows = bool(outputs.contact_shadows)
