"""Boxes round objects that carry no annotation."""

from __future__ import annotations

import json

import bpy
import numpy as np
from mathutils import Matrix

from ...core.geometry import FloatArray
from .imported import box_mesh, make

LABEL = "Static item"


def mark(scene: bpy.types.Scene, pose: FloatArray, size_m: FloatArray, uid: str = "") -> bpy.types.Object:
    """A new static item: what stands in the box of edges (3,) at ``pose`` (4, 4)."""
    number = 1
    while not uid:
        uid, number = f"item-{number}", number + 1
        uid = "" if uid in scene.unisim.static_items else uid
    obj = make(scene, "STATIC", uid, uid, box_mesh(size_m, LABEL))
    obj.rotation_mode = "QUATERNION"
    obj.show_wire = True
    obj.location, obj.rotation_quaternion, _ = Matrix(pose.tolist()).decompose()
    obj.unisim.model = json.dumps({"world_from_box": pose.tolist(), "size_m": np.asarray(size_m, float).tolist()})
    item = scene.unisim.static_items.add()
    item.name, item.model = uid, obj.unisim.model
    return obj


def forget(scene: bpy.types.Scene, uid: str) -> None:
    """Take the mark off an item: its boxes go, and what stands in them stays where it is."""
    for obj in [obj for obj in scene.objects if obj.unisim.kind == "STATIC" and obj.unisim.uid == uid]:
        bpy.data.objects.remove(obj)
    index = scene.unisim.static_items.find(uid)
    if index >= 0:
        scene.unisim.static_items.remove(index)
