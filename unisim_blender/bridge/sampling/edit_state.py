"""A digest of everything in a scene that edits change, to tell whether a result is of the scene as it is now."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable

import bpy
import numpy as np

from ..objects.animation import curves_of
from ..objects.imported import KINDS_OF_DRIVE, imported_objects
from ..objects.lamps import lamp_settings
from ..objects.meshes import size_of
from .from_keys import DELTA_PROPERTIES, KEYABLE_PROPERTIES, LENS_PROPERTIES

UNISIM_PROPERTIES = (
    "kind", "uid", "look", "look_scene", "mesh", "label", "model", "sees_ego_body", "row", "maneuvers",
)  # fmt: skip
"""Properties that say what an object of a drive represents."""


def edit_state(scene: bpy.types.Scene) -> str:
    """Return a digest of a scene's edits: the same before and after saving, at every frame, and after undo and redo."""
    digest = hashlib.blake2b(digest_size=16)
    for obj in imported_objects(scene, *KINDS_OF_DRIVE, "TRAJECTORY"):
        about = obj.unisim
        said: list[object] = [obj.name, obj.hide_render, *(getattr(about, name) for name in UNISIM_PROPERTIES)]
        if obj.type == "MESH":
            said += np.round(size_of(obj), 5).tolist()
        if obj.type == "CAMERA":
            said += [getattr(obj.data, name) for name in (*LENS_PROPERTIES, "type")]
        for part in (obj, *(obj.children_recursive if about.mesh else ())):
            said += _placed(part)
        digest.update(repr(said).encode())
    rest: list[object] = [(item.name, item.model) for item in scene.unisim.static_items]
    rest += [pair for layer in scene.view_layers for pair in _left_out(layer.layer_collection)]
    rest += [scene.render.frame_map_old, scene.render.frame_map_new, *lamp_settings(scene)]
    digest.update(repr(rest).encode())
    return digest.hexdigest()


def _placed(obj: bpy.types.Object) -> list[object]:
    """Return the values that animate an object, and those of its transforms that nothing animates."""
    said: list[object] = []
    data, animated = obj.animation_data, set()
    for curve in curves_of(obj):
        animated.add(curve.data_path)
        points = np.empty(2 * len(curve.keyframe_points), np.float32)
        kinds = np.empty(len(curve.keyframe_points), np.int32)
        curve.keyframe_points.foreach_get("co", points)
        curve.keyframe_points.foreach_get("interpolation", kinds)
        keys = hashlib.blake2b(points.tobytes() + kinds.tobytes(), digest_size=8).hexdigest()
        said += [curve.data_path, curve.array_index, curve.mute, keys]
    strips = [strip for track in data.nla_tracks for strip in track.strips] if data is not None else []
    said += [(s.name, s.frame_start, s.frame_end, s.scale, s.mute, s.action.name if s.action else "") for s in strips]
    if data is not None:
        animated |= {driver.data_path for driver in data.drivers}
    if not strips:
        said += [
            (name, _plain(getattr(obj, name)))
            for name in ("rotation_mode", *KEYABLE_PROPERTIES, *DELTA_PROPERTIES)
            if name not in animated
        ]
    said += [(constraint.type, constraint.mute, constraint.influence) for constraint in obj.constraints]
    if obj.parent is not None:
        said += [obj.parent.name, *(_plain(row) for row in obj.matrix_parent_inverse)]
    return said


def _plain(value: str | Iterable[float]) -> object:
    return value if isinstance(value, str) else tuple(value)


def _left_out(layer: bpy.types.LayerCollection) -> list[tuple[str, bool, bool]]:
    """Name, exclusion and hiding of a collection and of those in it."""
    state = [(layer.collection.name, layer.exclude, layer.collection.hide_render)]
    return state + [pair for child in layer.children for pair in _left_out(child)]
