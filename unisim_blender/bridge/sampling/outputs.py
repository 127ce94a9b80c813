"""Outputs that a scene renders: which captures, and which sensors."""

from __future__ import annotations

import bpy

from ...core.errors import UnisimError
from ...core.scenario.types import Scenario
from ...core.world.captures import CaptureKey
from ...core.world.drive import Drive
from ...editing.reading.scenario import moment_keys, names_captures
from ...editing.sensors.names import sensor_name
from ..objects.imported import title_of


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


def output_sensors(scene: bpy.types.Scene, selected: list[bpy.types.Object], drive: Drive) -> list[str] | None:
    """Return the names of the sensors that a sequence renders; None for all of them.

    Raises `UnisimError` where the choice leaves none.
    """
    chosen = scene.unisim.sequence_sensors
    if chosen == "ALL":
        return None
    if chosen == "CAMERA":
        found = [scene.camera] if scene.camera is not None and scene.camera.unisim.kind == "CAMERA" else []
        lacking = (
            "the active camera is no camera of the vehicle: select one and press Ctrl-Numpad 0, or choose All Sensors"
        )
    else:
        found = [obj for obj in selected if obj.unisim.kind in ("CAMERA", "LIDAR")]
        lacking = "no camera or LiDAR is selected: select some, or choose All Sensors"
    if not found:
        raise UnisimError(f"Output > Sensors: {lacking}")
    return [sensor_name(title_of(obj), obj.unisim.uid, obj.name == obj.unisim.home, drive) for obj in found]
