"""Sweeps as point-cloud meshes: recorded returns, and simulated ones."""

from __future__ import annotations

import bpy
import numpy as np
from numpy.typing import NDArray

from ..core.geometry import FloatArray
from .source import Source
from .things import collection_of, things

MOST_POINTS = 60_000
"""More are thinned for display."""
RECORDED, SIMULATED = "recorded", "simulated"
COLOURS = {RECORDED: (1.0, 0.85, 0.2, 1.0), SIMULATED: (0.2, 0.8, 1.0, 1.0)}


def put_points(
    scene: bpy.types.Scene, lidar: str, kind: str, points: FloatArray, attributes: dict[str, NDArray[np.generic]]
) -> bpy.types.Object:
    """Show points (N, 3) of the world, with attributes (N,), in place of those that were shown of that LiDAR and kind."""
    uid = f"{lidar} {kind}"
    thing = next((t for t in things(scene, "POINTS") if t.unisim.uid == uid), None)
    if thing is None:
        thing = bpy.data.objects.new(f"{lidar} ({kind})", bpy.data.meshes.new(f"UniSim {uid}"))
        collection_of(scene, "POINTS").objects.link(thing)
        thing.unisim.kind, thing.unisim.uid, thing.color = "POINTS", uid, COLOURS[kind]
        thing.hide_select = thing.hide_render = True
    step = -(-len(points) // MOST_POINTS) or 1
    mesh = thing.data
    mesh.clear_geometry()
    mesh.vertices.add(len(points[::step]))
    mesh.vertices.foreach_set("co", np.ascontiguousarray(points[::step], np.float32).ravel())
    for name, values in attributes.items():
        whole = np.issubdtype(values.dtype, np.integer)
        attribute = mesh.attributes.new(name, "INT" if whole else "FLOAT", "POINT")
        attribute.data.foreach_set("value", np.ascontiguousarray(values[::step], np.int32 if whole else np.float32))
    mesh.update()
    return thing


def show_recorded(scene: bpy.types.Scene, source: Source, frame: int) -> int:
    """Show the recorded returns of a frame, of every LiDAR; how many there are."""
    count = 0
    for name in source.drive.lidars if source.log is not None else ():
        assert source.log is not None
        if frame not in source.log.sweep_frames(name):
            put_points(scene, name, RECORDED, np.zeros((0, 3)), {})
            continue
        sweep = source.log.sweep(name, frame)
        put_points(scene, name, RECORDED, sweep.points, {"intensity": sweep.intensity, "class": sweep.semantic})
        count += len(sweep.points)
    return count


def hide_points(scene: bpy.types.Scene, kind: str) -> None:
    """Take one kind of points away."""
    for thing in [thing for thing in things(scene, "POINTS") if thing.unisim.uid.endswith(kind)]:
        mesh = thing.data
        bpy.data.objects.remove(thing)
        bpy.data.meshes.remove(mesh)
