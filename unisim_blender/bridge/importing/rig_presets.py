"""Rig presets: files of rigs in Blender's presets folders, read off the vehicle's sensors and put on it."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...core.errors import ScenarioError
from ...core.geometry import FloatArray, invert_pose
from ...core.rigs import SUFFIX, Rig, RigCamera, RigLidar
from ...core.world.drive import Drive
from ...editing import texts
from ...editing.layout.shapes import DISPLAY_M
from ...editing.sampled.scene import optical, rigid
from ...editing.sampled.source import DriveSource
from ...editing.sensors.mounts import from_frame, lag, lidar_json, lidar_model
from ...editing.sensors.names import preset_name, safe_name
from ..objects.imported import collection_of, imported_objects, original_of, rides_on_ego
from ..objects.sensors import camera_model_of, set_model
from ..objects.trajectories import remove
from ..sampling.stepping import frame_of
from .drive import fit_resolution, front_camera, import_sensors

FOLDER = "unisim/rigs"
"""Within Blender's presets folders."""


def users_folder() -> Path:
    """Return the folder of a user's own presets, made where it is missing."""
    return Path(bpy.utils.user_resource("SCRIPTS", path=f"presets/{FOLDER}", create=True))


def own_presets() -> list[Path]:
    """Presets in all of Blender's presets folders, those of shared script directories too, by name."""
    presets = [path for folder in bpy.utils.preset_paths(FOLDER) for path in Path(folder).glob(f"*{SUFFIX}")]
    return sorted(presets, key=lambda path: path.stem.lower())


def preset_file(name: str) -> Path:
    """The file of one's own preset of that name. Raises `ScenarioError` where no file can have it."""
    return users_folder() / f"{preset_name(name)}{SUFFIX}"


def is_recorded(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive) -> bool:
    """Return whether an object stands for a sensor of the log, and is no copy of one."""
    known = obj.unisim.uid in drive.cameras or obj.unisim.uid in drive.lidars
    return known and original_of(scene, obj.unisim.kind, obj.unisim.uid) == obj


def rig_of(scene: bpy.types.Scene, drive: Drive, about: str) -> tuple[Rig, list[str]]:
    """The sensors on the vehicle as they are mounted at this frame, and the names of sensors that no rig can hold:
    those that do not ride on the vehicle, and LiDARs without a beam table. Sensors that are hidden for
    renders are left out."""
    ego, cameras, lidars, left = next(imported_objects(scene, "EGO")), [], [], []
    taken: set[str] = set()
    for obj in imported_objects(scene, "CAMERA", "LIDAR"):
        if obj.hide_render:
            continue
        beams = lidar_model(obj.unisim.model) if obj.unisim.kind == "LIDAR" else None
        if not rides_on_ego(obj) or (beams is not None and not beams.beams):
            left.append(obj.name)
            continue
        name = texts.free_name(safe_name(obj.name), taken, "_")
        taken.add(name)
        pose = mount_of(scene, obj, ego, drive)
        if beams is None:
            cameras.append(RigCamera(name, camera_model_of(obj), optical(pose)))
        else:
            lidars.append(RigLidar(name, beams, pose))
    if not taken:
        raise ScenarioError(f'scene "{scene.name}": has no sensor on the vehicle that a rig preset could hold')
    return Rig(tuple(cameras), tuple(lidars), about), left


def put_rig(
    scene: bpy.types.Scene,
    drive: Drive,
    rig: Rig,
    replace: bool,
    offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> list[bpy.types.Object]:
    """Put a rig on the vehicle, displaced in the vehicle's axes. Return the new sensors.

    ``replace``: of the sensors on the vehicle, recorded ones are hidden, in renders too, and can be shown again; others
    go. Sensors that do not ride on the vehicle stay.
    """
    ego = next(imported_objects(scene, "EGO"))
    if replace:
        for obj in [obj for obj in imported_objects(scene, "CAMERA", "LIDAR") if rides_on_ego(obj)]:
            if is_recorded(scene, obj, drive):
                show_sensor(obj, False)
            else:
                _delete(obj)
    new = []
    for camera in rig.cameras:
        name = free_name(scene, drive, camera.name)
        obj = bpy.data.objects.new(name, bpy.data.cameras.new(f"UniSim {name}"))
        set_model(obj, camera.model)
        obj.data.display_size, obj.data.clip_end = DISPLAY_M, 1000.0
        new.append(_ride(scene, obj, "CAMERA", ego, optical(camera.ego_from_camera), offset_m))
    for lidar in rig.lidars:
        obj = bpy.data.objects.new(free_name(scene, drive, lidar.name), None)
        obj.empty_display_type, obj.empty_display_size = "CONE", DISPLAY_M
        obj.unisim.model = lidar_json(lidar.model)
        new.append(_ride(scene, obj, "LIDAR", ego, lidar.ego_from_lidar, offset_m))
    bpy.context.view_layer.update()
    look_ahead(scene)
    return new


def look_ahead(scene: bpy.types.Scene) -> None:
    """Make the camera that looks ahead the active one, where the active one is gone or hidden for renders."""
    if scene.camera is None or scene.camera.hide_render:
        scene.camera = front_camera(scene) or scene.camera
        if scene.camera is not None:
            scene.camera.hide_viewport = False  # Blender would not move it with the vehicle
        fit_resolution(scene)


def show_sensor(obj: bpy.types.Object, there: bool) -> None:
    """Let a sensor be there, or keep it in the file without being seen, rendered or written into scenarios."""
    obj.hide_render = obj.hide_viewport = not there


def hidden_sensors(scene: bpy.types.Scene, drive: Drive) -> set[str]:
    """Names of the log's sensors that are hidden for renders, or were deleted."""
    every = [*(("CAMERA", name) for name in drive.cameras), *(("LIDAR", name) for name in drive.lidars)]
    objects = {name: original_of(scene, kind, name) for kind, name in every}
    return {name for name, obj in objects.items() if obj is None or obj.hide_render}


def bring_back(scene: bpy.types.Scene, source: DriveSource) -> set[str]:
    """Show the log's sensors again that are hidden for renders, and make those anew that were deleted.
    Return their names."""
    drive = source.drive
    names = hidden_sensors(scene, drive)
    for kind, known in (("CAMERA", drive.cameras), ("LIDAR", drive.lidars)):
        for name in names & set(known):
            obj = original_of(scene, kind, name)
            if obj is None:
                import_sensors(scene, source, {name})
            else:
                show_sensor(obj, True)
    return names


def mount_of(scene: bpy.types.Scene, obj: bpy.types.Object, ego: bpy.types.Object, drive: Drive) -> FloatArray:
    """A sensor's pose (4, 4) on the vehicle at this frame, Blender's axes. A recorded one measures a little before or
    after the frame's time, by which its object is off its mount."""
    uid = obj.unisim.uid
    recorded = drive.cameras.get(uid) or drive.lidars.get(uid)
    late = lag(recorded, drive, from_frame(drive, frame_of(scene)))[0]
    poses = rigid(np.array([ego.matrix_world, obj.matrix_world], float))
    return np.asarray(late @ invert_pose(poses[0]) @ poses[1])


def free_name(scene: bpy.types.Scene, drive: Drive, wanted: str, has: str = "") -> str:
    """A name for a new sensor that no object has, and no sensor of the log: ``wanted``, or with a number behind it.

    ``has`` is the name that the sensor's object has so far.
    """
    sensors = {safe_name(obj.name) for obj in imported_objects(scene, "CAMERA", "LIDAR")}
    return texts.free_name(wanted, {*sensors, *drive.cameras, *drive.lidars, *bpy.data.objects.keys()} - {has}, "_")


def _ride(
    scene: bpy.types.Scene,
    obj: bpy.types.Object,
    kind: str,
    ego: bpy.types.Object,
    mount: FloatArray,
    offset_m: tuple[float, float, float],
) -> bpy.types.Object:
    collection_of(scene, kind).objects.link(obj)
    obj.unisim.kind, obj.unisim.uid = kind, obj.name
    obj.parent = ego
    obj.rotation_mode = "QUATERNION"
    place, obj.rotation_quaternion, _ = Matrix(mount.tolist()).decompose()
    obj.location = [a + b for a, b in zip(place, offset_m, strict=True)]
    return obj


def _delete(obj: bpy.types.Object) -> None:
    data = obj.data
    remove(obj)
    if data is not None and data.users == 0:
        bpy.data.batch_remove([data])
