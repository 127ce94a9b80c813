"""Sentences that say what a 3D view cannot show, and why."""

from __future__ import annotations

import bpy

from ...editing.images.views import outside_drive
from ...editing.layout.shapes import RECORDED
from ...editing.sampled.source import DriveSource
from ...editing.texts import Text
from ..importing.backgrounds import sees_recorded_image
from ..objects.cameras import model_of
from ..objects.imported import imported_objects
from ..sampling.stepping import frame_of
from .points import kind_of


def notices(
    scene: bpy.types.Scene,
    source: DriveSource,
    camera: bpy.types.Object | None,
    through: bpy.types.Object | None = None,
) -> list[str]:
    """Return a sentence for everything that was asked for and is not in the view.

    ``camera`` is the camera of the drive whose recorded image stands behind the boxes; None where the view
    has no such image. ``through`` is the camera of the drive that the view looks through, whatever it shows.
    """
    frame = frame_of(scene)
    if outside := outside_drive(frame, source.drive):
        return [outside]
    found: list[str] = []
    log = source.log
    through = through or camera
    if through is not None and not model_of(through).is_pinhole:
        found.append(
            Text(
                "The lens of {camera} bends lines: outlines and images follow it, Blender's own boxes do not",
                camera=through.name,
            )
        )
    if camera is not None and log is not None and camera.unisim.uid in source.drive.cameras:
        if int(frame) not in log.image_frames(camera.unisim.uid):
            found.append(Text("Frame {frame}: {sensors} recorded no image", frame=int(frame), sensors=camera.name))
        elif not sees_recorded_image(scene, camera, source.drive):
            if next(imported_objects(scene, "EGO"), None) is None:  # cameras stand where they were mounted on it
                found.append(
                    Text("The ego vehicle was deleted: the recorded image of {camera} is not shown", camera=camera.name)
                )
            else:
                found.append(Text("{camera} was moved: its recorded image is not shown", camera=camera.name))
    if scene.unisim.show_recorded:
        if log is None:
            found.append(
                Text("{log}: the log is not at hand, so no recorded points are shown", log=source.log_path.name)
            )
        else:  # of what was read and put there: to look into the log's files takes seconds
            clouds = [obj for obj in imported_objects(scene, "POINTS") if kind_of(obj) == RECORDED]
            lacking = [obj.unisim.uid.removesuffix(f" {RECORDED}") for obj in clouds if not obj.data.vertices]
            if lacking:
                found.append(
                    Text("Frame {frame}: {sensors} recorded no sweep", frame=int(frame), sensors=", ".join(lacking))
                )
    return found
