"""What a list of sensors says of each: resolution or beams, rate, where it is mounted, what became of it."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.world.drive import Camera, Drive, Lidar
from ...editing.sampled.poses import rigid, same
from ...editing.sensors.facts import Card, beams_of
from ...editing.sensors.lenses import degrees_across
from ...editing.sensors.recorded import recorded_pose
from ..importing.rig_presets import is_recorded, mount_of
from ..objects.cameras import model_of
from ..objects.imported import imported_objects, rides_on_ego

KINDS = ("CAMERA", "LIDAR")


def size_of_sensor(thing: bpy.types.Object) -> str:
    """Return a camera's resolution or a LiDAR's number of beams, as a list says it."""
    if thing.type == "CAMERA":
        model = model_of(thing)
        return f"{model.width}×{model.height}"
    beams, _ = beams_of(thing.unisim.model)
    return f"{beams} beams" if beams else "points"


def card_of_sensor(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive | None) -> Card:
    """Return the card of a camera or a LiDAR."""
    if thing.type == "CAMERA":
        model = model_of(thing)
        view = f"{degrees_across(model):.0f} degrees across"
    else:
        view = f"up to {beams_of(thing.unisim.model)[1]:.0f} m"
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


def _place(scene: bpy.types.Scene, thing: bpy.types.Object, drive: Drive) -> str:
    ego = next(imported_objects(scene, "EGO"), None)
    if ego is None or not rides_on_ego(thing):
        return "not on the vehicle"
    x, y, z = np.round(mount_of(scene, thing, ego, drive)[:3, 3], 2) + 0.0  # no -0.00
    return f"{x:.2f}, {y:.2f}, {z:.2f} m"
