"""Kinds of objects that each 3D view shows and lets people pick, so that a camera's view is what the camera sees.

Through a camera, sensors and the ego vehicle would stand in the image and take clicks that are meant for actors. In
Rendered shading with the engine UniSim, Blender would draw a camera's background image over the rendered one; a view
that does not show cameras does not show their background images. The same holds in every shading where the camera was
moved, or recorded no image of the frame: boxes and an image from elsewhere would not agree. Blender keeps these
switches for each view, so views beside it stay as they are.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

from ..bridge.importing.backgrounds import background_to_show, sees_recorded_image, show_background
from ..bridge.objects.ego_bodies import bodies_differ, show_bodies, shown_as
from ..bridge.objects.imported import source_of
from ..bridge.objects.sensors import drawn_tiny, frustums_differ, resize_frustums
from ..bridge.sampling.stepping import frame_of
from ..bridge.window import redraw, run_soon
from ..core.errors import UnisimError
from ..registering import Drawing

EMPTIES = ("show_object_viewport_empty", "show_object_select_empty")
CAMERAS = ("show_object_viewport_camera", "show_object_select_camera")
SWITCHES = (*EMPTIES, *CAMERAS)
HIDDEN_KEY = "unisim_hidden"
"""A screen's custom property: which switches of which views this module has turned off."""


def turned_off(through: str, rendered: bool, sensors: bool, elsewhere: bool = False, chosen: bool = False) -> set[str]:
    """Return the switches that a view is to have off.

    ``through`` is what `looks_through` says. ``rendered``: whether the engine UniSim draws the view. ``sensors``:
    whether sensors are to be seen from outside. ``elsewhere``: whether a camera of the drive stands elsewhere than its
    images were recorded. ``chosen``: whether the ego vehicle or a LiDAR is selected and active, as by a click in the
    Outliner: Blender moves nothing that a view does not show. A rendered view shows the image alone all the same.
    """
    off: set[str] = set()
    if through == "RIG":
        off |= {*EMPTIES, "show_object_select_camera"}
    if through and (rendered or elsewhere):
        off.add("show_object_viewport_camera")
    if not through and not sensors:
        off |= set(SWITCHES)
    return off - {EMPTIES[0]} if chosen and not rendered else off


def looks_through(scene: bpy.types.Scene, space: Any) -> str:
    """Return what a 3D view looks through: "RIG" for a camera of the drive, "OTHER" for another one, "" for none."""
    if space.region_3d.view_perspective != "CAMERA" or scene.camera is None:
        return ""
    return "RIG" if scene.camera.unisim.kind == "CAMERA" else "OTHER"


def wanted(scene: bpy.types.Scene, space: Any) -> set[str]:
    """Return the switches that a 3D view of a scene is to have off."""
    if not scene.unisim.log or space.region_3d is None:
        return set()
    through = looks_through(scene, space)
    rendered = space.shading.type == "RENDERED" and scene.render.engine == "UNISIM"
    elsewhere = through == "RIG" and not rendered and _elsewhere(scene)
    return turned_off(through, rendered, scene.unisim.show_sensors, elsewhere, _chosen())


def _chosen() -> bool:
    """Whether an empty of the drive is selected and active."""
    active = bpy.context.view_layer.objects.active if bpy.context.view_layer is not None else None
    return active is not None and active.unisim.kind in ("EGO", "LIDAR") and active.select_get()


def _elsewhere(scene: bpy.types.Scene) -> bool:
    """Whether the active camera does not see what its recorded image shows."""
    try:
        source = source_of(scene)
        uid, log = scene.camera.unisim.uid, source.log
        recorded = log is None or uid not in log.drive.cameras or int(frame_of(scene)) in log.image_frames(uid)
        return not recorded or not sees_recorded_image(scene, scene.camera, source.drive)
    except (UnisimError, OSError):
        return False


def _behind(scene: bpy.types.Scene) -> Path | None:
    """The recorded image that is to be put behind the active camera."""
    if not scene.unisim.log or scene.camera is None or scene.camera.unisim.kind != "CAMERA":
        return None
    try:
        return background_to_show(scene, scene.camera, source_of(scene).log)
    except (UnisimError, OSError):
        return None  # the panel says so


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn: nothing may be changed before that is over."""
    scene, screen, space = bpy.context.scene, bpy.context.screen, bpy.context.space_data
    off, before = wanted(scene, space), _noted(screen).get(list(screen.areas).index(bpy.context.area), set())
    if off != before or any(getattr(space, switch) for switch in off) or lagging(scene):
        follow_soon()


def lagging(scene: bpy.types.Scene) -> bool:
    """Return whether bodies, frustums or a recorded image are not drawn as the views of a scene look at them."""
    through = cameras_looked_through(scene)
    if scene.camera in through and _behind(scene) is not None and not bpy.app.is_job_running("RENDER"):
        return True
    return bodies_differ(scene, shown_as(scene, through)) or frustums_differ(scene, drawn_tiny(through))


def cameras_looked_through(scene: bpy.types.Scene) -> list[bpy.types.Object | None]:
    """Return the camera that each 3D view of a scene looks through, None for a view through none."""
    through = []
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas if window.scene == scene else ():
            region = area.spaces.active.region_3d if area.type == "VIEW_3D" else None
            if region is not None:
                through.append(scene.camera if region.view_perspective == "CAMERA" else None)
    return through


def follow_soon(*_: object) -> None:
    """Have all views follow as soon as nothing is drawn."""
    run_soon(_follow)


def _follow() -> None:
    for window in bpy.context.window_manager.windows:
        noted = _noted(window.screen)
        for index, area in enumerate(window.screen.areas):
            if area.type != "VIEW_3D":
                continue
            space, off = area.spaces.active, wanted(window.scene, area.spaces.active)
            for switch in noted.get(index, set()) - off:
                setattr(space, switch, True)
            for switch in off:
                setattr(space, switch, False)
            noted[index] = off
        window.screen[HIDDEN_KEY] = {str(index): " ".join(sorted(off)) for index, off in noted.items() if off}
    for scene in {window.scene for window in bpy.context.window_manager.windows}:
        through = cameras_looked_through(scene)
        if bodies_differ(scene, drawn := shown_as(scene, through)):
            show_bodies(scene, drawn, scene.view_layers)
        resize_frustums(scene, drawn_tiny(through))
        if scene.camera in through and not bpy.app.is_job_running("RENDER"):
            path = _behind(scene)
            if path is not None:
                show_background(scene.camera, path)
    redraw("VIEW_3D")


def _noted(screen: bpy.types.Screen) -> dict[int, set[str]]:
    noted = screen.get(HIDDEN_KEY)
    return {int(index): set(text.split()) for index, text in noted.items()} if noted else {}


DRAWINGS = (Drawing(draw),)
TIMERS = (_follow,)
