"""A view from above beside the camera's, which follows the ego vehicle with its forward direction up.

It is an ordinary 3D view: one from straight above, orthographic, locked to the ego vehicle. Blender itself moves such a
view with the object that it is locked to; turning it is done here. Files keep it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import bpy
from bpy.app.handlers import persistent
from mathutils import Euler

from ...bridge.objects.imported import imported_objects
from ...bridge.window import areas, drive, fit_camera_view
from ...translations import message
from ..operator_bases import Needing

SHARE = 0.36
"""Of the 3D view's width that the new view takes."""
ACROSS_M = 70.0
"""Distance of the view, which is about as many metres as its longer side shows."""
DRAWN_S = 0.1
"""Time after which the areas of a window have been drawn in their new sizes."""
STEEP = 0.999
"""Least cosine of the angle from straight down at which a view counts as one from above."""


def views(scene: bpy.types.Scene) -> Iterator[tuple[bpy.types.Area, Any, bpy.types.Object]]:
    """Yield the bird's-eye views of a scene: area, space, and the ego vehicle that it follows."""
    for area in areas("VIEW_3D"):
        space = area.spaces.active
        ego, looks = space.lock_object, space.region_3d
        if ego is None or looks is None or ego.unisim.kind != "EGO" or ego.name not in scene.objects:
            continue
        if looks.view_perspective == "ORTHO" and looks.view_rotation.to_matrix()[2][2] > STEEP:
            yield area, space, ego


@persistent
def follow(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Turn the bird's-eye views to the ego vehicle of the frame that is shown."""
    for area, space, ego in () if bpy.app.background else views(scene):
        turn(space, ego)
        area.tag_redraw()


def turn(space: Any, ego: bpy.types.Object) -> None:
    """Have a view look straight down, with the ego vehicle's forward direction up."""
    forward = ego.matrix_world.to_3x3().col[0]
    space.region_3d.view_rotation = Euler((0.0, 0.0, math.atan2(-forward.x, forward.y))).to_quaternion()


def fit_cameras() -> None:
    """Fit the camera's frame into the views that look through it, as a timer: they have their new size once drawn."""
    for area in areas("VIEW_3D") if bpy.context.scene.camera is not None else ():
        looks = area.spaces.active.region_3d
        if looks is not None and looks.view_perspective == "CAMERA":
            fit_camera_view(area)


class UNISIM_OT_birds_eye(Needing, bpy.types.Operator):
    """Open a view from above beside this one, which follows the ego vehicle, or close it"""

    bl_label = "Bird's-Eye View"
    needs = (drive,)

    def execute(self, context: bpy.types.Context) -> set[str]:
        opened, ego = list(views(context.scene)), next(imported_objects(context.scene, "EGO"), None)
        bpy.app.timers.register(fit_cameras, first_interval=DRAWN_S)
        for area, *_ in opened:
            window = next(one for one in context.window_manager.windows if area in list(one.screen.areas))
            with context.temp_override(window=window, screen=window.screen, area=area):
                bpy.ops.screen.area_close()
        if opened:
            return {"FINISHED"}
        if ego is None or context.area is None or context.area.type != "VIEW_3D" or context.screen.show_fullscreen:
            self.report({"WARNING"}, message("Needs a 3D view that is not maximised, and the ego vehicle"))
            return {"CANCELLED"}
        before = set(context.screen.areas)
        with context.temp_override(area=context.area):
            bpy.ops.screen.area_split(direction="VERTICAL", factor=1 - SHARE)
        (area,) = set(context.screen.areas) - before
        space = area.spaces.active
        space.lock_object, space.shading.type = ego, "SOLID"
        space.show_region_ui = space.show_region_toolbar = space.show_gizmo = False
        space.region_3d.view_perspective, space.region_3d.view_distance = "ORTHO", ACROSS_M
        turn(space, ego)
        return {"FINISHED"}


HANDLERS = (("frame_change_post", follow),)
TIMERS = (fit_cameras,)
