"""Mesh objects as the ego vehicle's body: put on the vehicle, taken off it, and shown only to those who
do not ride on it."""

from __future__ import annotations

from collections.abc import Iterable

import bpy
import numpy as np

from ...core.geometry import FloatArray
from .imported import collection_of, imported_objects, sees_body, stand_at
from .meshes import make_actor, size_of

REAR_OVERHANG_M = 1.0
"""Distance from the vehicle's origin, which is about its rear axle, to the rear end of a body."""
DISPLAY_KEY = "unisim_shown_as"
"""A custom property of what is hidden or drawn as a box here: how it was drawn before."""


def make_body(
    scene: bpy.types.Scene, objects: list[bpy.types.Object], label: str, forward: str, on_vehicle: bool
) -> bpy.types.Object:
    """Let objects be one body of the ego vehicle, the others parented to the last. Return that one.

    ``forward`` is a key of `meshes.FORWARD`, or "AUTO". ``on_vehicle`` puts it there: pointing ahead, its
    underside at the height of the vehicle's origin, its rear `REAR_OVERHANG_M` behind that; without it the body stays where it
    stands at this frame.
    """
    ego, body = next(imported_objects(scene, "EGO")), objects[-1]
    for part in (body, *objects[:-1]):
        world = part.matrix_world.copy()
        part.parent = None if part is body else body
        part.matrix_world = world
    bpy.context.view_layer.update()
    make_actor(body, label, forward)
    bpy.context.view_layer.update()
    if on_vehicle:
        size = size_of(body)
        mount = np.eye(4)
        mount[:3, 3] = size[0] / 2 - REAR_OVERHANG_M, 0.0, size[2] / 2
    else:
        mount = np.array(ego.matrix_world.inverted() @ body.matrix_world, float)
    for collection in list(body.users_collection):
        collection.objects.unlink(body)
    collection_of(scene, "BODY").objects.link(body)
    mount_body(body, ego, mount, label)
    return body


def mount_body(body: bpy.types.Object, ego: bpy.types.Object, mount: FloatArray, label: str) -> None:
    """Parent a mesh object to the vehicle, at a pose (4, 4) in its axes."""
    about = body.unisim
    about.kind, about.mesh, about.label = "BODY", True, label
    about.uid = about.home = about.look = about.look_scene = ""
    body.parent = ego
    body.matrix_parent_inverse.identity()
    body.rotation_mode = "QUATERNION"
    stand_at(body, mount)


def release_body(body: bpy.types.Object) -> None:
    """Let a body be an ordinary object again, which no sensor sees, where it stands at this frame."""
    world = body.matrix_world.copy()
    body.parent = None
    body.matrix_world = world
    body.unisim.kind, body.unisim.mesh = "NONE", False
    _show(body, "SHOWN", bpy.context.view_layer)


def shown_as(scene: bpy.types.Scene, through: Iterable[bpy.types.Object | None]) -> str:
    """Return how views are to draw bodies, by the cameras that they look through (None for no camera): "HIDDEN" where
    all are on the vehicle, "BOUNDS" where some are, else "SHOWN"."""
    sights = [camera is None or sees_body(camera) for camera in through]
    return "SHOWN" if all(sights) else "BOUNDS" if any(sights) else "HIDDEN"


def bodies_differ(scene: bpy.types.Scene, wanted: str) -> bool:
    """Return whether some body is not drawn as ``wanted``."""
    return any(body.get(DISPLAY_KEY, "SHOWN").partition(" ")[0] != wanted for body in imported_objects(scene, "BODY"))


def show_bodies(scene: bpy.types.Scene, wanted: str, layers: Iterable[bpy.types.ViewLayer]) -> None:
    """Draw all bodies as `shown_as` has it."""
    for body in imported_objects(scene, "BODY"):
        for layer in layers:
            _show(body, wanted, layer)


def _show(body: bpy.types.Object, wanted: str, layer: bpy.types.ViewLayer) -> None:
    """Hide a body and its parts, or draw them as boxes, or as they were drawn before."""
    for part in (body, *body.children_recursive):
        now, _, before = part.get(DISPLAY_KEY, "SHOWN").partition(" ")
        if now == "SHOWN":
            before = part.display_type
        if part.name in layer.objects:
            if now == "HIDDEN" and wanted != "HIDDEN":
                part.hide_set(False, view_layer=layer)
            elif wanted == "HIDDEN":
                part.hide_set(True, view_layer=layer)
        if wanted == "SHOWN":
            if now != "SHOWN":
                part.display_type = before
                del part[DISPLAY_KEY]
        else:
            part.display_type = "BOUNDS" if wanted == "BOUNDS" else before
            part[DISPLAY_KEY] = f"{wanted} {before}"
