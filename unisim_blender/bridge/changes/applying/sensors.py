"""The sensors of a scenario in an imported scene."""

from __future__ import annotations

import bpy
import numpy as np

from ....core.geometry import invert_pose
from ....core.scenario.sensors.document import CameraSpec, LidarSpec
from ....core.world.drive import Camera, Lidar
from ....editing.sampled.scene import optical
from ....editing.sensors.mounts import lag, lidar_json
from ...importing.drive import ride_on_vehicle
from ...objects.cameras import set_model
from ...objects.imported import imported_objects, make
from ...objects.trajectories import remove
from .target import Target


def apply_sensors(target: Target) -> None:
    """Remove sensors that are gone, and make or change the others."""
    scene, scenario, edited, clock = target.scene, target.scenario, target.edited, target.clock
    if scenario.sensors is None:
        return
    there: dict[str, Camera | Lidar] = {**edited.cameras, **edited.lidars}
    for obj in list(imported_objects(scene, "CAMERA", "LIDAR")):
        if obj.unisim.uid not in there:
            remove(obj)
    specs: list[CameraSpec | LidarSpec] = [*(scenario.sensors.cameras or ()), *(scenario.sensors.lidars or ())]
    free = {spec.id for spec in specs if spec.trajectory is not None}
    # a recorded sensor that stays on its mount rides on the vehicle as it was imported, wherever that drives
    moved = {spec.id for spec in specs if spec.mount or spec.mount_offset or spec.trajectory or spec.like}
    kept = {*target.recorded.cameras, *target.recorded.lidars} - moved
    told = {spec.id: "ALWAYS" if spec.sees_ego_body else "NEVER" for spec in specs if spec.sees_ego_body is not None}
    for name, sensor in there.items():
        kind = "CAMERA" if isinstance(sensor, Camera) else "LIDAR"
        data = bpy.data.cameras.new(name) if kind == "CAMERA" and not _known(scene, name) else None
        obj = _known(scene, name) or make(scene, kind, name, name, data)
        obj.unisim.sees_ego_body = told.get(name, "AUTO")
        times = clock.of_sensor(sensor).times_s
        if isinstance(sensor, Camera):
            set_model(obj, sensor.model)
            world = optical(sensor.world_from_camera.at(times))
        else:
            obj.unisim.model = lidar_json(sensor.model)
            world = sensor.world_from_lidar.at(times)
        if name in kept and data is None:
            continue
        if name in free:
            ride_on_vehicle(obj, world, np.tile(np.eye(4), (len(world), 1, 1)), None, clock)
        else:
            # where it is mounted, put where the recorded vehicle's motion has it at the frames
            mount, late = invert_pose(edited.world_from_ego.at(times)) @ world, lag(sensor, target.recorded, clock)
            ride_on_vehicle(obj, invert_pose(late) @ mount, late, target.ego, clock)


def _known(scene: bpy.types.Scene, name: str) -> bpy.types.Object | None:
    return next((obj for obj in imported_objects(scene, "CAMERA", "LIDAR") if obj.unisim.uid == name), None)
