"""Rig presets: files of rigs in Blender's presets folders, read off the vehicle's sensors and put on it."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ...core.errors import ScenarioError
from ...core.geometry import FloatArray, invert_pose
from ...core.rigs import SUFFIX, Rig, RigCamera, RigLidar
from ...core.world.drive import CameraModel, Drive, LidarModel
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
    if replace:
        for obj in [obj for obj in imported_objects(scene, "CAMERA", "LIDAR") if rides_on_ego(obj)]:
            if is_recorded(scene, obj, drive):
                show_sensor(obj, False)
            else:
                _delete(obj)
    place = Matrix.Translation(offset_m)
    new = [
        *(
            add_sensor(scene, drive, camera.name, camera.model, optical(camera.ego_from_camera))
            for camera in rig.cameras
        ),
        *(add_sensor(scene, drive, lidar.name, lidar.model, lidar.ego_from_lidar) for lidar in rig.lidars),
    ]
    for obj in new:
        obj.location = place @ obj.location
    bpy.context.view_layer.update()
    look_ahead(scene)
    return new


def add_sensor(
    scene: bpy.types.Scene, drive: Drive | None, wanted: str, model: CameraModel | LidarModel, mount: FloatArray
) -> bpy.types.Object:
    """Put a new camera or LiDAR on the vehicle, at a pose (4, 4) in its axes, Blender's, under the name ``wanted`` or one
    like it."""
    name = free_name(scene, drive, wanted)
    if isinstance(model, CameraModel):
        kind, obj = "CAMERA", bpy.data.objects.new(name, bpy.data.cameras.new(f"UniSim {name}"))
        set_model(obj, model)
        obj.data.display_size, obj.data.clip_end = DISPLAY_M, 1000.0
    else:
        kind, obj = "LIDAR", bpy.data.objects.new(name, None)
        obj.empty_display_type, obj.empty_display_size = "CONE", DISPLAY_M
        obj.unisim.model = lidar_json(model)
    collection_of(scene, kind).objects.link(obj)
    obj.unisim.kind, obj.unisim.uid = kind, obj.name
    obj.parent = next(imported_objects(scene, "EGO"))
    obj.rotation_mode = "QUATERNION"
    obj.location, obj.rotation_quaternion, _ = Matrix(mount.tolist()).decompose()
    return obj


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
    names = hidden_sensors(scene, source.drive)
    for kind, known in (("CAMERA", source.drive.cameras), ("LIDAR", source.drive.lidars)):
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


def free_name(scene: bpy.types.Scene, drive: Drive | None, wanted: str) -> str:
    """A name for a new sensor that no object has, and no sensor of the log, where that is at hand: ``wanted``, or with a
    number behind it."""
    taken = {safe_name(obj.name) for obj in imported_objects(scene, "CAMERA", "LIDAR")} | set(bpy.data.objects.keys())
    return texts.free_name(wanted, taken | ({*drive.cameras, *drive.lidars} if drive is not None else set()), "_")


def _delete(obj: bpy.types.Object) -> None:
    data = obj.data
    remove(obj)
    if data is not None and data.users == 0:
        bpy.data.batch_remove([data])
