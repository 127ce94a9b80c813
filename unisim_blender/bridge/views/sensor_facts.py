"""Facts that a list of sensors shows of each: resolution or beams, rate, where it is mounted, what became of it."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.world.drive import Camera, Drive, Lidar
from ...editing.sampled.scene import rigid, same
from ...editing.sensors.lenses import degrees_across
from ...editing.sensors.mounts import recorded_pose
from ...editing.sensors.names import SensorCard, beams_of
from ...editing.texts import Text, counted, series
from ..importing.rig_presets import is_recorded, mount_of
from ..objects.imported import imported_objects, rides_on_ego
from ..objects.sensors import camera_model_of

KINDS = ("CAMERA", "LIDAR")


def size_of_sensor(obj: bpy.types.Object) -> str:
    """Return a camera's resolution or a LiDAR's number of beams, as a list says it."""
    if obj.type == "CAMERA":
        model = camera_model_of(obj)
        return f"{model.width}×{model.height}"
    beams, _ = beams_of(obj.unisim.model)
    return counted(beams, "1 beam", "{count} beams") if beams else Text("points")


def card_of_sensor(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive | None) -> SensorCard:
    """Return the card of a camera or a LiDAR."""
    if obj.type == "CAMERA":
        model = camera_model_of(obj)
        view = Text("{angle:.0f} degrees across", angle=degrees_across(model))
    else:
        view = Text("up to {length:.0f} m", length=beams_of(obj.unisim.model)[1])
    hidden = [Text("hidden")] if obj.hide_render else []
    if drive is None:
        return SensorCard(view, "", series(hidden))
    return SensorCard(view, _place(scene, obj, drive), series([state_of(scene, obj, drive), *hidden]))


def state_of(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive) -> str:
    """Return whether a sensor is as it was recorded, moved, or added."""
    sensor = recorded_sensor(scene, obj, drive)
    if sensor is None:
        return Text("added" if rides_on_ego(obj) else "added, off the vehicle")
    pose = recorded_pose(sensor, drive, float(scene.frame_current))
    moved = not same(rigid(np.array(obj.matrix_world, float)), pose).all()
    return Text("recorded, moved" if moved else "recorded")


def recorded_sensor(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive) -> Camera | Lidar | None:
    """Return the sensor of the log that an object stands for; None for one that is new, or a copy."""
    if not is_recorded(scene, obj, drive):
        return None
    known: dict[str, Camera] | dict[str, Lidar] = drive.cameras if obj.unisim.kind == "CAMERA" else drive.lidars
    return known.get(obj.unisim.uid)


def _place(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive) -> str:
    ego = next(imported_objects(scene, "EGO"), None)
    if ego is None or not rides_on_ego(obj):
        return Text("not on the vehicle")
    x, y, z = np.round(mount_of(scene, obj, ego, drive)[:3, 3], 2) + 0.0  # no -0.00
    return f"{x:.2f}, {y:.2f}, {z:.2f} m"
