"""Recorded images behind the rig's cameras."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.data.log import Log
from ...core.geometry import FloatArray
from ...core.world.drive import Drive
from ...editing.sampled.clock import Clock
from ...editing.sampled.mounts import sensor_times
from ...editing.sampled.poses import optical
from ..objects.cameras import model_of
from ..sampling.stepping import frame_of

OPACITY = 0.5
NEAR_M, NEAR_RAD = 0.05, 0.005
"""Within these of where it was recorded a camera sees its recorded image."""


def set_background(camera: bpy.types.Camera, log: Log, sensor_id: str) -> None:
    """Show a sensor's recorded images behind its camera, frame by frame."""
    frames = log.image_frames(sensor_id)
    if not frames:
        return
    path = log.image_path(sensor_id, frames[0])
    name = f"UniSim {sensor_id}"
    image = bpy.data.images.get(name)
    if image is None:
        image = bpy.data.images.load(str(path))
        image.name = name
    image.filepath, image.source = str(path), "SEQUENCE"
    camera.background_images.clear()
    shown = camera.background_images.new()
    shown.image, shown.alpha, shown.display_depth = image, OPACITY, "BACK"
    # Blender counts a sequence's pictures from its first: file number = frame - frame_start + 1 + frame_offset
    user = shown.image_user
    user.frame_start, user.frame_offset = frames[0], frames[0] - 1
    user.frame_duration = frames[-1] - frames[0] + 1
    camera.show_background_images = True


def sees_recorded_image(scene: bpy.types.Scene, camera: bpy.types.Object, drive: Drive) -> bool:
    """Return whether a camera of the drive stands, in the frame that is shown, where its image was recorded, with the recorded
    intrinsics. Boxes and a recorded image taken from elsewhere would not agree."""
    recorded = drive.cameras.get(camera.unisim.uid)
    if recorded is None or model_of(camera) != recorded.model:
        return False
    then, now = recorded_pose(drive, camera.unisim.uid, frame_of(scene)), np.array(camera.matrix_world, float)
    turned = np.linalg.norm(now[:3, :3] - then[:3, :3]) / np.sqrt(2)
    return bool(np.linalg.norm(now[:3, 3] - then[:3, 3]) <= NEAR_M and turned <= NEAR_RAD)


def recorded_pose(drive: Drive, uid: str, frame: float) -> FloatArray:
    """Return where a camera of the drive was when it recorded a frame's image: (4, 4) in the world, Blender's axes.

    The newest answer for each camera is kept: every redraw asks for it, more than once.
    """
    kept = _poses.get(uid)
    if kept is None or kept[0] is not drive or kept[1] != frame:
        camera, frames = drive.cameras[uid], frame + np.array([0.0, 1.0])  # a clock has two at least
        times = sensor_times(Clock(frames, Clock.of(drive).time_s(frames)), camera.time_s)
        _poses[uid] = kept = drive, frame, optical(camera.world_from_camera.at(times))[0]
    return kept[2]


_poses: dict[str, tuple[Drive, float, FloatArray]] = {}
"""By camera: the drive and the frame that were asked for last, and the pose."""
