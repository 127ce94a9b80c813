"""Sweeps as point-cloud meshes: recorded returns, and simulated ones. The meshes hold the data; `clouds.py`
draws them."""

from __future__ import annotations

import uuid

import bpy
import numpy as np
from numpy.typing import NDArray

from ...core.geometry import FloatArray
from ...editing.layout.shapes import RECORDED, SIMULATED, PointColours, point_colours
from ...editing.sensors.mounts import RecordedReturns
from ..objects.imported import collection_of, imported_objects

MAX_POINTS = 60_000
"""More are thinned for display."""
KINDS = (RECORDED, SIMULATED)


def put_points(
    scene: bpy.types.Scene, lidar: str, kind: str, points: FloatArray, attributes: dict[str, NDArray[np.generic]]
) -> bpy.types.Object:
    """Show points (N, 3) of the world, with attributes (N,), in place of those that were shown of
    that LiDAR and kind."""
    assert points.ndim == 2 and points.shape[1] == 3, f"points of shape {points.shape}"
    uid = f"{lidar} {kind}"
    obj = next((t for t in imported_objects(scene, "POINTS") if t.unisim.uid == uid), None)
    if obj is None:
        obj = bpy.data.objects.new(f"{lidar} ({kind})", bpy.data.meshes.new(f"UniSim {uid}"))
        collection_of(scene, "POINTS").objects.link(obj)
        obj.unisim.kind, obj.unisim.uid = "POINTS", uid
        obj.hide_select = obj.hide_render = True
        obj.hide_viewport = True  # else Blender's own dots lie over the coloured points
    obj.unisim.stamp = uuid.uuid4().hex
    step = -(-len(points) // MAX_POINTS) or 1
    mesh = obj.data
    mesh.clear_geometry()
    mesh.vertices.add(len(points[::step]))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points[::step], np.float32).ravel())
    for name, values in attributes.items():
        whole = np.issubdtype(values.dtype, np.integer)
        attribute = mesh.attributes.new(name, "INT" if whole else "FLOAT", "POINT")
        attribute.data.foreach_set("value", np.ascontiguousarray(values[::step], np.int32 if whole else np.float32))
    mesh.update()
    return obj


def put_recorded(scene: bpy.types.Scene, sweeps: list[RecordedReturns]) -> None:
    """Show recorded returns that were read."""
    for sweep in sweeps:
        put_points(scene, sweep.lidar, RECORDED, sweep.points, sweep.attributes)


def kind_of(obj: bpy.types.Object) -> str:
    """Whether points are recorded or simulated."""
    return next(kind for kind in KINDS if obj.unisim.uid.endswith(kind))


def points_of(obj: bpy.types.Object, by: str) -> tuple[NDArray[np.float32], PointColours]:
    """Points (N, 3) of the world and their colours (N, 4), by ONE, INTENSITY, DEPTH or INSTANCE."""
    mesh = obj.data
    count = len(mesh.vertices)
    points = np.empty(3 * count, np.float32)
    mesh.vertices.foreach_get("co", points)
    attributes: dict[str, NDArray[np.generic]] = {}
    for name in ("intensity", "depth", "instance", "class"):
        if (attribute := mesh.attributes.get(name)) is not None:
            attributes[name] = np.empty(count, np.int32 if attribute.data_type == "INT" else np.float32)
            attribute.data.foreach_get("value", attributes[name])
    return points.reshape(-1, 3), point_colours(kind_of(obj), by, attributes, count)


def hide_points(scene: bpy.types.Scene, kind: str) -> None:
    """Take one kind of points away."""
    for obj in [obj for obj in imported_objects(scene, "POINTS") if kind_of(obj) == kind]:
        mesh = obj.data
        bpy.data.objects.remove(obj)
        bpy.data.meshes.remove(mesh)
