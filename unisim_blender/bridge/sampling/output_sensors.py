"""Which sensors a sequence renders, and how wide their images are."""

from __future__ import annotations

import bpy

from ...core.errors import UnisimError
from ...core.world.drive import Drive
from ...editing.sensors.names import sensor_name
from ..objects.imported import title_of


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
