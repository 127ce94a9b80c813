"""Whether a scene renders the captures that its scenario stated, or its frame range."""

from __future__ import annotations

import bpy

from ...core.scenario.types import Scenario
from ...core.world.captures import CaptureKey
from ...core.world.drive import Drive
from ...editing.reading.stated import moment_keys, names_captures


def captures_stated(scene: bpy.types.Scene) -> bool:
    """Return whether the frames or times that the imported scenario stated hold: until the frame range is changed."""
    about = scene.unisim
    now = (scene.frame_start, scene.frame_end, scene.frame_step)
    return names_captures(about.stated) and tuple(about.stated_range) == now


def rendered_keys(scene: bpy.types.Scene, scenario: Scenario, drive: Drive) -> set[CaptureKey]:
    """Return the keys of the moments that rendering a scene's scenario makes. Raises `ScenarioError`."""
    frames = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
    if captures_stated(scene) and isinstance(scenario.frames, tuple):
        return moment_keys(scenario, drive, scenario.frames)
    return moment_keys(scenario, drive, frames)
