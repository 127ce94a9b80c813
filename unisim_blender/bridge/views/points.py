"""Sweeps as point-cloud meshes: what LiDARs returned, and beams that did not return, recorded and simulated. The meshes
hold the data; `features/points` draws them."""

from __future__ import annotations

import json
import uuid
from collections.abc import Sequence

import bpy
import numpy as np

from ...editing.sensors.sweeps import DROPS, RECORDED, SIMULATED, ViewedSweep
from ..objects.imported import collection_of, imported_objects

MAX_CELLS = 400_000
"""Of sweeps with more beams than these every second one, third one and so on is shown."""
KINDS = (RECORDED, SIMULATED, *DROPS.values())
ABOUT_KEY = "unisim_sweep"
"""A mesh's custom property: the classes that its points' attribute counts, and the frame, as JSON."""


def put_sweep(scene: bpy.types.Scene, sweep: ViewedSweep) -> bpy.types.Object:
    """Show a sweep in place of the one that was shown of that LiDAR and kind."""
    points = sweep.points
    assert points.ndim == 2 and points.shape[1] == 3, f"points of shape {points.shape}"
    uid = f"{sweep.lidar} {sweep.kind}"
    obj = next((t for t in imported_objects(scene, "POINTS") if t.unisim.uid == uid), None)
    if obj is None:
        obj = bpy.data.objects.new(f"{sweep.lidar} ({sweep.kind})", bpy.data.meshes.new(f"UniSim {uid}"))
        collection_of(scene, "POINTS").objects.link(obj)
        obj.unisim.kind, obj.unisim.uid = "POINTS", uid
        obj.hide_select = obj.hide_render = True
        obj.hide_viewport = True  # else Blender's own dots lie over the coloured points
    obj.unisim.stamp = uuid.uuid4().hex
    number = np.asarray(sweep.attributes.get("cell", np.full(len(points), -1)))
    number = np.where(number < 0, np.arange(len(points)), number)
    shown = number % (int(number.max(initial=0)) // MAX_CELLS + 1) == 0
    mesh = obj.data
    mesh.clear_geometry()
    mesh[ABOUT_KEY] = json.dumps([sweep.classes, sweep.frame])
    mesh.vertices.add(int(shown.sum()))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points[shown], np.float32).ravel())
    for name, values in sweep.attributes.items():
        whole = np.issubdtype(values.dtype, np.integer)
        attribute = mesh.attributes.new(name, "INT" if whole else "FLOAT", "POINT")
        attribute.data.foreach_set("value", np.ascontiguousarray(values[shown], np.int32 if whole else np.float32))
    mesh.update()
    return obj


def kind_of(obj: bpy.types.Object) -> str:
    """Return which of `KINDS` points are."""
    return next(kind for kind in KINDS if obj.unisim.uid.endswith(f" {kind}"))


def sweep_of(obj: bpy.types.Object) -> ViewedSweep:
    """Return the sweep that an object shows."""
    mesh, kind = obj.data, kind_of(obj)
    count = len(mesh.vertices)
    points, attributes = np.empty(3 * count, np.float32), {}
    mesh.vertices.foreach_get("co", points)
    for name in ("intensity", "depth", "ring", "cell", "instance", "class"):
        if (attribute := mesh.attributes.get(name)) is not None:
            attributes[name] = np.empty(count, np.int32 if attribute.data_type == "INT" else np.float32)
            attribute.data.foreach_get("value", attributes[name])
    classes, frame = json.loads(mesh.get(ABOUT_KEY, "[[], 0]"))
    if not classes:  # files of earlier versions count other classes
        attributes.pop("class", None)
    lidar = obj.unisim.uid.removesuffix(f" {kind}")
    return ViewedSweep(lidar, kind, points.reshape(-1, 3), attributes, tuple(classes), frame)


def hide_points(scene: bpy.types.Scene, kinds: Sequence[str]) -> None:
    """Take points of some kinds away."""
    for obj in [obj for obj in imported_objects(scene, "POINTS") if kind_of(obj) in kinds]:
        mesh = obj.data
        bpy.data.objects.remove(obj)
        bpy.data.meshes.remove(mesh)
