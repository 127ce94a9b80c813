"""Recorded images behind the rig's cameras.

Blender finds a sequence's images by the numbers in their names. Images that are named otherwise, by their times for
example, are put behind a camera one at a time, as frames are shown.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ...core.data.log import Log
from ...core.world.drive import Drive
from ...editing.sensors.mounts import recorded_camera_pose, sees_the_same
from ..objects.sensors import camera_model_of
from ..sampling.stepping import frame_of

OPACITY = 0.5


def set_background(camera: bpy.types.Camera, log: Log, sensor_id: str) -> None:
    """Show a sensor's recorded images behind its camera, frame by frame."""
    frames = log.image_frames(sensor_id)
    path = log.image_path(sensor_id, frames[0]) if frames else None
    if path is None:
        return
    name = f"UniSim {sensor_id}"
    image = bpy.data.images.get(name)
    if image is None:
        image = bpy.data.images.load(str(path))
        image.name = name
    image.filepath, image.source = str(path), "SEQUENCE" if _are_numbered(log, sensor_id) else "FILE"
    camera.background_images.clear()
    shown = camera.background_images.new()
    shown.image, shown.alpha, shown.display_depth = image, OPACITY, "BACK"
    # Blender counts a sequence's images from its first: file number = frame - frame_start + 1 + frame_offset
    user = shown.image_user
    user.frame_start, user.frame_offset = frames[0], frames[0] - 1
    user.frame_duration = frames[-1] - frames[0] + 1
    camera.show_background_images = True


def _are_numbered(log: Log, sensor_id: str) -> bool:
    """Whether the names of a sensor's images are the numbers of their frames, by the first and the last."""
    frames = log.image_frames(sensor_id)
    ends = [(frame, log.image_path(sensor_id, frame)) for frame in (frames[0], frames[-1])]
    named = [path for frame, path in ends if path is not None and path.stem.isdecimal() and int(path.stem) == frame]
    return len(named) == 2 and len({(path.parent, path.suffix, len(path.stem)) for path in named}) == 1


def background_to_show(scene: bpy.types.Scene, camera: bpy.types.Object, log: Log | None) -> Path | None:
    """Return the recorded image of the frame that is shown, where another one stands behind a camera of the drive; None where
    nothing is to be changed: Blender itself shows a sequence's."""
    frame = frame_of(scene)
    image = _image(camera)
    if log is None or image is None or image.source != "FILE" or frame != int(frame):
        return None
    path = log.image_path(camera.unisim.uid, int(frame)) if camera.unisim.uid in log.drive.cameras else None
    return path if path is not None and Path(bpy.path.abspath(image.filepath)) != path else None


def show_background(camera: bpy.types.Object, path: Path) -> None:
    """Put an image behind a camera."""
    image = _image(camera)
    if image is not None:
        image.filepath = str(path)


def _image(camera: bpy.types.Object) -> bpy.types.Image | None:
    images = camera.data.background_images
    return images[0].image if len(images) else None


def sees_recorded_image(scene: bpy.types.Scene, camera: bpy.types.Object, drive: Drive) -> bool:
    """Return whether a camera of the drive stands, in the frame that is shown, where its image was recorded, with the recorded
    intrinsics. Boxes and a recorded image taken from elsewhere would not agree."""
    recorded = drive.cameras.get(camera.unisim.uid)
    if recorded is None or camera_model_of(camera) != recorded.model:
        return False
    then = recorded_camera_pose(drive, camera.unisim.uid, frame_of(scene))
    return sees_the_same(np.array(camera.matrix_world, float), then)
