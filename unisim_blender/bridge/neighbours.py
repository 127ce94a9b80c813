"""The scene about the frame that is shown, without leaving it: the viewport must not change frames.

Where a thing is now is known; where it is a frame earlier and later follows from its own and its parents' keys. What else
moves it (a constraint, the NLA) is taken to stand still for that tenth of a second: no more than a rolling shutter shows it.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import bpy
import numpy as np
from mathutils import Matrix, Quaternion

from ..core.geometry import FloatArray
from .animation import curves_of
from .clock import Clock
from .poses import rigid
from .sampling import Sampled, frame_of, sample


def sample_now(
    scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph, clock: Clock, also: tuple[bpy.types.Object, ...] = ()
) -> Sampled:
    """The scene's things at the frames of ``clock``, which the frame that is shown is about."""
    now = frame_of(scene)
    here = Clock(np.array([now, now + 1.0]), clock.time_s(np.array([now, now + 1.0])))
    one = sample(scene, depsgraph, here, lambda frame: None, also)
    things = []
    for thing in one.things:
        owner = scene.objects.get(thing.name) or next(other for other in also if other.name == thing.name)
        keyed_now = np.linalg.inv(_keyed(owner, now))
        steps = np.stack([keyed_now @ _keyed(owner, frame) for frame in clock.frames])
        hidden = [_hidden(owner, frame) for frame in clock.frames]
        there = np.array([bool(thing.there[0]) if now_hidden is None else not now_hidden for now_hidden in hidden])
        there &= not owner.hide_render
        things.append(replace(thing, poses=rigid(thing.poses[0] @ steps), there=there))
    return replace(one, clock=clock, things=tuple(things))


def _keyed(thing: bpy.types.Object, frame: float) -> FloatArray:
    """Where a thing's own keys and its parents' put it at a frame."""
    values = {(curve.data_path, curve.array_index): curve.evaluate(frame) for curve in curves_of(thing)}

    def numbers(path: str, now: Iterable[float]) -> list[float]:
        return [values.get((path, i), value) for i, value in enumerate(now)]

    place = Matrix.Translation(numbers("location", thing.location))
    if thing.rotation_mode == "QUATERNION":
        turn = Quaternion(numbers("rotation_quaternion", thing.rotation_quaternion)).normalized().to_matrix().to_4x4()
    elif thing.rotation_mode == "AXIS_ANGLE":
        turn = thing.matrix_basis.to_quaternion().to_matrix().to_4x4()
    else:
        euler = thing.rotation_euler.copy()
        euler[:] = numbers("rotation_euler", thing.rotation_euler)
        turn = euler.to_matrix().to_4x4()
    own = np.array(place @ turn, float)
    if thing.parent is None:
        return own
    return _keyed(thing.parent, frame) @ np.array(thing.matrix_parent_inverse, float) @ own


def _hidden(thing: bpy.types.Object, frame: float) -> bool | None:
    """Whether keys hide a thing at a frame; None where none do."""
    for curve in curves_of(thing):
        if curve.data_path == "hide_viewport":
            return curve.evaluate(frame) > 0.5
    return None
