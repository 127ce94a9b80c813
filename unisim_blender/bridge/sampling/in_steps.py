"""Sampling of objects' poses at all frames of a drive, in steps of some milliseconds, so that a window goes on in
between.

Keys tell where most objects are; the rest is evaluated in a scene beside. The frame that is shown stays.
`sampling.sample_all` evaluates the scene at every frame instead: it is the plain reference, and what runs
without a window.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import replace

import bpy
import numpy as np

from ...core.geometry import BoolArray, FloatArray
from ...editing.reading.scenario import file_of
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import CHANGING, Sampled, SampledObject, Scaling
from ..objects.animation import curves_of, scale_changes
from ..objects.imported import KINDS_OF_DRIVE, imported_objects
from ..objects.meshes import extent_of, model_of
from .adjacent_frames import moved_by_keys
from .from_keys import Sampler, evaluated
from .stepping import depsgraph_of, refuse_stretching, shown_names

FRAMES_AT_ONCE = 4
"""Frames that are evaluated beside in one step."""

StepsDone = tuple[int, int]
"""Steps that are done, and all steps."""


def sample_steps(scene: bpy.types.Scene, clock: Clock) -> Generator[StepsDone, None, Sampled]:
    """Return, after some steps, the scene's objects at all of the clock's frames.

    The scene must not change between steps. Raises `UnisimError` where it cannot be read.
    """
    refuse_stretching(scene)
    found = list(imported_objects(scene, *KINDS_OF_DRIVE))
    free = [obj for obj in found if not by_keys_alone(obj)]
    parts = range(0, len(clock.frames), FRAMES_AT_ONCE) if free else ()
    done, total = 0, len(parts) + len(found)
    beside: dict[str, tuple[FloatArray, BoolArray]] = {}
    if free:
        evaluations = []
        for at in parts:
            evaluations.append(evaluated(scene, clock.frames[at : at + FRAMES_AT_ONCE].tolist(), free))
            yield (done := done + 1), total
        matrices, there = (np.concatenate([part[i] for part in evaluations]) for i in (0, 1))
        beside = {obj.name: (matrices[:, i], there[:, i]) for i, obj in enumerate(free)}
    shown = scene == bpy.context.scene
    layer = bpy.context.view_layer if shown else scene.view_layers[0]
    live = any(window.scene == scene for window in bpy.context.window_manager.windows)
    sampler = Sampler(scene, clock, shown_names(layer.layer_collection), live)
    sampled = []
    for obj in found:
        sampled.append(_completed(scene, obj, sampler.sample(obj, *beside.get(obj.name, ()))))
        yield (done := done + 1), total
    return Sampled(scene.name, clock, tuple(sampled), {item.name: item.model for item in scene.unisim.static_items})


def by_keys_alone(obj: bpy.types.Object) -> bool:
    """Return whether `Sampler` finds an object where Blender evaluates it: no deltas of the scale, no muted curves, and
    no parent whose path moves what is parented to it."""
    above: bpy.types.Object | None = obj
    while above is not None:
        muted = any(curve.mute or (curve.group is not None and curve.group.mute) for curve in curves_of(above))
        deltas = any(curve.data_path.startswith("delta_") for curve in curves_of(above))
        if (
            muted
            or deltas
            or tuple(above.delta_scale) != (1.0, 1.0, 1.0)
            or (above is not obj and above.type == "CURVE")
        ):
            return False
        above = above.parent
    return moved_by_keys(obj)


def _completed(scene: bpy.types.Scene, obj: bpy.types.Object, one: SampledObject) -> SampledObject:
    """Return a sampled object with the values that `Sampler` does not read: its size, the model of its surface, and
    keys of its scale."""
    if not obj.unisim.mesh:
        scaling = one.scaling
        if not scaling.fault and scale_changes(obj):
            scaling = Scaling(scaling.factors, CHANGING)
        size = extent_of(obj) * np.array(scaling.factors)
        return replace(one, scaling=scaling, size_m=tuple(size.tolist()), mesh="")
    size_m, file, poses = tuple(extent_of(obj).tolist()), "", one.poses
    if one.there.any():
        model, middle = model_of(obj, depsgraph_of(scene))
        poses = poses.copy()
        poses[:, :3, 3] += poses[:, :3, :3] @ middle
        size_m, file = tuple(model.size_m.tolist()), str(file_of(model))
    return replace(one, poses=poses, size_m=size_m, mesh=file)
