"""What a list of sensors says of each: resolution or beams, rate, where it is mounted, what became of it."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache

import bpy
import numpy as np

from ...core.geometry import FloatArray
from ...core.world.drive import Camera, Drive, Lidar
from ...editing.sampled.clock import Clock
from ...editing.sampled.mounts import sensor_times
from ...editing.sampled.poses import optical, rigid, same
from ..importing.rig_presets import from_frame, is_recorded, mount_of
from ..objects.cameras import model_of
from ..objects.imported import rides_on_ego, things

KINDS = ("CAMERA", "LIDAR")


@dataclass(frozen=True)
class Card:
    """What is said of one sensor: ``view``, its angle or range; ``mount``, where on the vehicle; ``state``, what became of it.
    What only the drive tells is "" where that is not at hand."""

    view: str
    mount: str
    state: str


def size_of_sensor(thing: bpy.types.Object) -> str:
    """Return a camera's resolution or a LiDAR's number of beams, as a list says it."""
    if thing.type == "CAMERA":
        model = model_of(thing)
        return f"{model.width}×{model.height}"
    beams, _ = _beams(thing.unisim.model)
    return f"{beams} beams" if beams else "points"


def rate_of(drive: Drive | None) -> str:
    """Return how often a sensor measures: once a frame of the log."""
    return "" if drive is None else f"{Clock.of(drive).rate:.3g} Hz"


def card_of_sensor(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive | None) -> Card:
    """Return the card of a camera or a LiDAR."""
    if thing.type == "CAMERA":
        model = model_of(thing)
        view = f"{np.degrees(2 * np.arctan(model.width / 2 / model.fx)):.0f} degrees across"
    else:
        view = f"up to {_beams(thing.unisim.model)[1]:.0f} m"
    hidden = ", hidden" if thing.hide_render else ""
    if drive is None:
        return Card(view, "", hidden.removeprefix(", "))
    return Card(view, _place(scene, thing, drive), state_of(scene, thing, drive) + hidden)


def state_of(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive) -> str:
    """Return whether a sensor is as it was recorded, moved, or added."""
    sensor = recorded_sensor(scene, thing, drive)
    if sensor is None:
        return "added" if rides_on_ego(thing) else "added, off the vehicle"
    pose = recorded_pose(sensor, drive, float(scene.frame_current))
    moved = not same(rigid(np.array(thing.matrix_world, float)), pose).all()
    return "recorded" + (", moved" if moved else "")


def recorded_sensor(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive) -> Camera | Lidar | None:
    """Return the sensor of the log that an object stands for; None for one that is new, or a copy."""
    if not is_recorded(scene, thing, drive):
        return None
    known: dict[str, Camera] | dict[str, Lidar] = drive.cameras if thing.unisim.kind == "CAMERA" else drive.lidars
    return known.get(thing.unisim.uid)


def recorded_pose(sensor: Camera | Lidar, drive: Drive, frame: float) -> FloatArray:
    """Return where a sensor was recorded at a frame (4, 4), Blender's axes."""
    at = sensor_times(from_frame(drive, frame), sensor.time_s)[0]
    if isinstance(sensor, Camera):
        return optical(sensor.world_from_camera.at(at))
    return sensor.world_from_lidar.at(at)


def _place(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive) -> str:
    ego = next(things(scene, "EGO"), None)
    if ego is None or not rides_on_ego(thing):
        return "not on the vehicle"
    x, y, z = np.round(mount_of(scene, thing, ego, drive)[:3, 3], 2) + 0.0  # no -0.00
    return f"{x:.2f}, {y:.2f}, {z:.2f} m"


@lru_cache(maxsize=64)
def _beams(text: str) -> tuple[int, float]:
    """How many beams a LiDAR's table has, and its range in metres."""
    values = json.loads(text)
    return len(values["elevation_rad"]), float(values["max_range_m"])
