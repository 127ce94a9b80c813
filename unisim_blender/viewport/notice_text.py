"""Sentences about what a 3D view cannot show, written in its upper part; stripes over a frame outside the drive."""

from __future__ import annotations

import bpy

from ..bridge.importing.backgrounds import sees_recorded_image
from ..bridge.objects.imported import imported_objects, source_of
from ..bridge.objects.sensors import camera_model_of
from ..bridge.sampling.stepping import frame_of
from ..bridge.views.points import kind_of
from ..core.errors import UnisimError
from ..editing.images.views import BAND_PX, outside_drive, stripes
from ..editing.sampled.source import DriveSource
from ..editing.sensors.sweeps import RECORDED
from ..editing.texts import Text, translatable
from ..registering import Drawing
from ..translations import localized
from .compare_view import drawn_view
from .overlay_layout import LINE_PX, draw_batch, fill, ground_size, in_rows, overlay_layout, write_rows
from .view_types import looks_through

COLOUR = (1.0, 0.82, 0.35, 1.0)
SHADE, STRIPE = (0.0, 0.0, 0.0, 0.35), (0.6, 0.6, 0.6, 0.16)
"""Over a view of a frame outside the drive that the engine does not draw, and in stripes over that."""


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    context = bpy.context
    scene, space, region = context.scene, context.space_data, context.region
    if not scene.unisim.log or not space.overlay.show_overlays:
        return
    rendered = space.shading.type == "RENDERED" and scene.render.engine == "UNISIM"
    through = scene.camera if looks_through(scene, space) == "RIG" else None
    camera = None if rendered else through
    try:
        source = source_of(scene)
        lines = [localized(line) for line in notices(scene, source, camera, through)]
        view = drawn_view(region) if rendered else None
        if view is not None:
            lines += [text for text in (view.problem, view.warning, *map(localized, view.left_out)) if text]
        outside = outside_drive(frame_of(scene), source.drive)
    except (UnisimError, OSError):
        return  # the panel says so
    scale = context.preferences.system.ui_scale
    if outside and not rendered:  # the engine marks its images itself, without overlays and in F12, too
        fill(0, 0, region.width, region.height, SHADE)
        draw_batch("TRIS", stripes(region.width, region.height, BAND_PX * scale), STRIPE)
    box = overlay_layout(context).notices
    rows = in_rows(lines, box.width, scale)
    fit = max(1, int(box.height // (LINE_PX * scale)))
    if len(rows) > fit:
        rows = [*rows[: fit - 1], rows[fit - 1] + " …"]
    if rows:
        width, _ = ground_size(rows, scale)
        write_rows(rows, (box.left + box.right - width) / 2, box.top, scale, COLOUR)


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
    sentences: list[str] = []
    log, through = source.log, through or camera
    if through is not None and not camera_model_of(through).is_pinhole:
        bends = translatable(
            "The lens of {camera} bends lines: outlines and images follow it, Blender's own boxes do not"
        )
        sentences += [Text(bends, camera=through.name)]
    if camera is not None and log is not None and camera.unisim.uid in source.drive.cameras:
        ego = next(imported_objects(scene, "EGO"), None)  # cameras stand where they were mounted on it
        if int(frame) not in log.image_frames(camera.unisim.uid):
            sentences += [Text("Frame {frame}: {sensors} recorded no image", frame=int(frame), sensors=camera.name)]
        elif not sees_recorded_image(scene, camera, source.drive) and ego is None:
            deleted = translatable("The ego vehicle was deleted: the recorded image of {camera} is not shown")
            sentences += [Text(deleted, camera=camera.name)]
        elif not sees_recorded_image(scene, camera, source.drive):
            sentences += [Text("{camera} was moved: its recorded image is not shown", camera=camera.name)]
    if scene.unisim.show_recorded and log is None:
        absent = translatable("{log}: the log is not at hand, so no recorded points are shown")
        sentences += [Text(absent, log=source.log_path.name)]
    elif scene.unisim.show_recorded:  # of what was read and put there: to look into the log's files takes seconds
        clouds = [obj for obj in imported_objects(scene, "POINTS") if kind_of(obj) == RECORDED]
        lacking = ", ".join(obj.unisim.uid.removesuffix(f" {RECORDED}") for obj in clouds if not obj.data.vertices)
        if lacking:
            sentences += [Text("Frame {frame}: {sensors} recorded no sweep", frame=int(frame), sensors=lacking)]
    return sentences


DRAWINGS = (Drawing(draw, "POST_PIXEL"),)
