"""Recorded images behind the rig's cameras."""

from __future__ import annotations

import bpy
import numpy as np

from ...core.data.log import Log
from ...core.world.drive import Drive
from ...editing.sensors.recorded import recorded_camera_pose, sees_the_same
from ..objects.cameras import model_of
from ..sampling.stepping import frame_of

OPACITY = 0.5


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
    # Blender counts a sequence's images from its first: file number = frame - frame_start + 1 + frame_offset
    user = shown.image_user
    user.frame_start, user.frame_offset = frames[0], frames[0] - 1
    user.frame_duration = frames[-1] - frames[0] + 1
    camera.show_background_images = True


def sees_recorded_image(scene: bpy.types.Scene, camera: bpy.types.Object, drive: Drive) -> bool:
    """Return whether a camera of the drive stands, in the frame that is shown, where its image was recorded, with the recorded
    intrinsics. Boxes and a recorded image taken from elsewhere would not agree, nor do they through a lens that bends lines:
    Blender draws boxes through a pinhole."""
    recorded = drive.cameras.get(camera.unisim.uid)
    if recorded is None or model_of(camera) != recorded.model or not recorded.model.is_pinhole:
        return False
    then = recorded_camera_pose(drive, camera.unisim.uid, frame_of(scene))
    return sees_the_same(np.array(camera.matrix_world, float), then)
