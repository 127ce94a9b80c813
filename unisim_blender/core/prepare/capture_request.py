"""Request to a process that keeps scenes for one capture: a state of the world, a sensor, and which scenes it is of.

Whoever asks applies the edits, which takes no renderer; who renders reads neither log nor scenario for it.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..scenes.scene import other_scenes
from ..sensors.rays import exposure_window
from ..world.drive import Box, Camera, Drive, Lidar
from ..world.encoding import encode_sensor, encode_state
from ..world.replay import DriveStates


def capture_request(
    drive: Drive, parked: Mapping[str, Box], sensor: Camera | Lidar, time_s: float, log: Path, scene: Path | None
) -> dict[str, Any]:
    """Return the request for what ``sensor`` measures at ``time_s`` in an edited drive, as a JSON object.

    ``parked`` are the boxes of parked actors that the static field does not hold (`SceneHeader.parked`). ``scene`` is
    the trained scene's folder; None renders surfels of the log in folder ``log``. In the request, ``others`` are the
    folders of the scenes that any actor of the drive was inserted from: they stay loaded, whoever is
    there at the moment.
    """
    window = exposure_window(sensor, time_s)
    return {
        "state": encode_state(DriveStates(drive, parked).state(*window)),
        "sensor": encode_sensor(sensor, *window),
        "time_s": time_s,
        "log": str(log),
        "scene": None if scene is None else str(scene),
        "others": list(other_scenes(drive)),
    }
