"""Sampling of a Blender scene's objects at some frames: the scene is stepped through them, so whatever moves an object
counts alike, a key, a parent, a constraint or the NLA.

What is read here holds nothing of Blender's, so it can be looked at in any thread.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import bpy
import numpy as np

from ...core.errors import UnisimError
from ...core.geometry import BoolArray, FloatArray
from ...editing.reading.scenario import file_of
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import CHANGING, Sampled, SampledObject, Scaling, rigid, scaling_of
from ...editing.sampled.source import DriveSource
from ..objects.animation import keys_hide, scale_changes
from ..objects.imported import (
    KINDS_OF_DRIVE,
    imported_objects,
    look_scene_of,
    sees_body,
    skipped_sensors,
    title_of,
)
from ..objects.lamps import lamp_settings
from ..objects.meshes import extent_of, mesh_model_of, size_of
from ..objects.sensors import camera_model_of
from ..objects.trajectories import span_of
from ..objects.weather import scene_light, scene_weather

SetFrame = Callable[[int], object]


def frame_of(scene: bpy.types.Scene) -> float:
    """The frame that is shown, with its fraction."""
    return float(scene.frame_current + scene.frame_subframe)


@contextmanager
def preserve_frame(scene: bpy.types.Scene) -> Iterator[None]:
    """Go back to the frame that was shown."""
    frame, part = scene.frame_current, scene.frame_subframe
    try:
        yield
    finally:
        scene.frame_set(frame, subframe=part)


def sample(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    clock: Clock,
    set_frame: SetFrame,
    also: Iterable[bpy.types.Object] = (),
) -> Sampled:
    """The scene's objects at each frame of ``clock``. ``set_frame`` takes the depsgraph to a frame; ``also`` are
    cameras that are no part of the rig."""
    refuse_stretching(scene)
    objects = [*imported_objects(scene, *KINDS_OF_DRIVE)]
    objects += [obj for obj in also if obj not in objects]
    shown = shown_names(depsgraph.view_layer_eval.layer_collection)
    # keys say when an object is there; without keys, disabling it in viewports is a matter of the view alone
    keyed = [keys_hide(obj) for obj in objects]
    matrices = np.empty((len(objects), len(clock.frames), 4, 4))
    there = np.zeros((len(objects), len(clock.frames)), bool)
    for at, frame in enumerate(clock.frames):
        set_frame(int(frame))
        for i, obj in enumerate(objects):
            now = obj.evaluated_get(depsgraph)
            matrices[i, at] = now.matrix_world
            there[i, at] = not (now.hide_viewport and keyed[i]) and not now.hide_render and obj.name in shown
    poses, size = rigid(matrices), image_size(scene.render)
    sampled = []
    for i, obj in enumerate(objects):
        scaling = Scaling() if obj.unisim.mesh else scaling_of(matrices[i], poses[i], there[i])
        sampled.append(completed(described(obj, poses[i], there[i], scaling, size), obj, lambda: depsgraph))
    items, weather, light = static_items(scene), scene_weather(scene), scene_light(scene)
    return Sampled(
        scene.name, clock, tuple(sampled), items, skipped_sensors(scene), weather, light, lamp_settings(scene)
    )


def static_items(scene: bpy.types.Scene) -> dict[str, str]:
    """Return a scene's marked static items: their boxes as JSON by id."""
    return {item.name: item.model for item in scene.unisim.static_items}


def described(
    obj: bpy.types.Object, poses: FloatArray, there: BoolArray, scaling: Scaling, image: tuple[int, int]
) -> SampledObject:
    """Return an object at N frames: its poses (N, 4, 4), whether it is there (N,), and its properties. ``image`` (width,
    height) is the size of images of cameras that have none of their own."""
    about = obj.unisim
    return SampledObject(
        name=obj.name,
        kind=about.kind,
        uid=about.uid,
        original_name=about.home,
        appearance=about.look,
        appearance_scene=look_scene_of(obj),
        model=about.model,
        index=obj.pass_index,
        poses=poses,
        there=there,
        camera=camera_model_of(obj, image) if obj.type == "CAMERA" else None,
        label=about.label,
        scaling=scaling,
        called=title_of(obj),
        sees_body=sees_body(obj),
        span=span_of(obj),
        row=about.row,
        maneuvers=about.maneuvers,
        size_m=tuple(size_of(obj).tolist())
        if about.kind == "ACTOR" and (about.maneuvers or not about.mesh)
        else (0.0, 0.0, 0.0),
    )


def completed(
    sampled: SampledObject, obj: bpy.types.Object, depsgraph: Callable[[], bpy.types.Depsgraph]
) -> SampledObject:
    """Return a sampled object with its size, the file of its model, and whether keys change its scale."""
    if not sampled.scaling.fault and scale_changes(obj):  # keys tell it whichever frames are looked at
        sampled = replace(sampled, scaling=Scaling(sampled.scaling.factors, CHANGING))
    if not obj.unisim.mesh or not sampled.there.any():
        size = extent_of(obj) * np.array(sampled.scaling.factors)
        return replace(sampled, size_m=tuple(size.tolist()), mesh="")
    model, middle = mesh_model_of(obj, depsgraph())
    poses = sampled.poses.copy()
    poses[:, :3, 3] += poses[:, :3, :3] @ middle
    return replace(sampled, poses=poses, size_m=tuple(model.size_m.tolist()), mesh=str(file_of(model)))


def refuse_stretching(scene: bpy.types.Scene) -> None:
    """Raise `UnisimError` where a scene's frames are not the log's."""
    render = scene.render
    if render.frame_map_old != render.frame_map_new:
        raise UnisimError(
            f'scene "{scene.name}": Output > Frame Range > Time Stretching takes frame {render.frame_map_old} to '
            f"{render.frame_map_new}, so its frames are not the log's: set both alike, and retime actors instead"
        )


def image_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Width and height of an image, in pixels."""
    percent = render.resolution_percentage
    return render.resolution_x * percent // 100, render.resolution_y * percent // 100


def sample_all(scene: bpy.types.Scene, clock: Clock) -> Sampled:
    """The scene's objects at all of the clock's frames; the frame that is shown stays."""
    with preserve_frame(scene):
        return sample(scene, depsgraph_of(scene), clock, scene.frame_set)


def depsgraph_of(scene: bpy.types.Scene) -> bpy.types.Depsgraph:
    """Return a scene's depsgraph, made where no window shows the scene."""
    if scene == bpy.context.scene:
        return bpy.context.evaluated_depsgraph_get()
    scene.frame_set(scene.frame_current)
    return scene.view_layers[0].depsgraph


def shown_names(layer: bpy.types.LayerCollection) -> set[str]:
    """Names of the objects in some collection that is neither excluded nor hidden for renders."""
    if layer.exclude or layer.collection.hide_render:
        return set()
    names = {obj.name for obj in layer.collection.objects}
    return names.union(*(shown_names(child) for child in layer.children))


def moment(
    scene: bpy.types.Scene,
    depsgraph: bpy.types.Depsgraph,
    source: DriveSource,
    frame: float,
    set_frame: SetFrame,
    camera: bpy.types.Object,
) -> tuple[Sampled, SampledObject]:
    """The scene about ``frame``, and what ``camera`` is in it."""
    clock = Clock.of(source.drive).around(frame)
    sampled = sample(scene, depsgraph, clock, set_frame, also=[camera])
    return sampled, next(obj for obj in sampled.objects if obj.name == camera.name)
