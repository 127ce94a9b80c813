"""LiDAR points drawn into the 3D view in colours: Blender itself shows a mesh's vertices all alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
from mathutils import Vector

from ...bridge.objects.imported import imported_objects
from ...bridge.views.points import kind_of, points_of
from ...editing.layout.shapes import RECORDED
from ...registering import Drawing

SIZE, BEHIND_SIZE = 3.0, 2.0
"""Of a point, and of one behind a surface, an actor's box say, in pixels of an ordinary display."""
Build = Callable[[bpy.types.Object, str], Any]
_clouds: dict[tuple[str, str], tuple[tuple[str, str], Any]] = {}
"""By scene and object: the points' stamp and what they are coloured by, and what is drawn."""


def clouds(scene: bpy.types.Scene, build: Build) -> list[tuple[bpy.types.Object, Any]]:
    """The scene's clouds and what is drawn of each, built only where points or colours are others than they were."""
    by = scene.unisim.points_colour
    objects = list(imported_objects(scene, "POINTS"))
    names = {(scene.name, obj.name) for obj in objects}
    for name in [
        name for name in _clouds if name not in names and (name[0] == scene.name or name[0] not in bpy.data.scenes)
    ]:
        del _clouds[name]
    for obj in objects:
        name, key = (scene.name, obj.name), (obj.unisim.stamp, by)
        if name not in _clouds or _clouds[name][0] != key:
            _clouds[name] = key, build(obj, by)
    return [(obj, _clouds[scene.name, obj.name][1]) for obj in objects]


def offset(scene: bpy.types.Scene, obj: bpy.types.Object) -> Vector:
    """Return the displacement of a drawn cloud: recorded ones to the vehicle's left where the scene has them beside."""
    aside = scene.unisim.recorded_offset_m if kind_of(obj) == RECORDED else 0.0
    ego = next(imported_objects(scene, "EGO"), None)
    left = ego.matrix_world.to_quaternion() @ Vector((0.0, 1.0, 0.0)) if ego is not None else Vector((0.0, 1.0, 0.0))
    return left * aside


def draw() -> None:
    """Called by Blender whenever a 3D view is drawn."""
    import gpu

    context = bpy.context
    scene, space = context.scene, context.space_data
    if not space.overlay.show_overlays:
        return
    drawn = [(offset(scene, obj), batch) for obj, batch in clouds(scene, _batch) if batch is not None]
    if not drawn:
        return
    # the engine's image has no depth: over it all points are seen alike
    flat = space.shading.type == "RENDERED" and scene.render.engine == "UNISIM"
    for test, size in (("NONE", SIZE),) if flat else (("GREATER", BEHIND_SIZE), ("LESS_EQUAL", SIZE)):
        gpu.state.depth_test_set(test)
        gpu.state.depth_mask_set(test == "LESS_EQUAL")
        gpu.state.point_size_set(size * context.preferences.system.pixel_size)
        for aside, batch in drawn:
            with gpu.matrix.push_pop():
                gpu.matrix.translate(aside)
                batch.draw(_shader())
    gpu.state.depth_mask_set(False)
    gpu.state.depth_test_set("NONE")
    gpu.state.point_size_set(1.0)


def _shader() -> Any:
    import gpu

    try:
        return gpu.shader.from_builtin("POINT_FLAT_COLOR")
    except ValueError:  # before Blender 4.5
        return gpu.shader.from_builtin("FLAT_COLOR")


def _batch(obj: bpy.types.Object, by: str) -> Any:
    from gpu_extras.batch import batch_for_shader

    points, colours = points_of(obj, by)
    if not len(points):
        return None
    return batch_for_shader(_shader(), "POINTS", {"pos": points, "color": colours})


DRAWINGS = (Drawing(draw),)


def unregister() -> None:
    """Forget the points."""
    _clouds.clear()
