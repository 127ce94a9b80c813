"""Trajectories as keyframes: location and quaternion, LINEAR, and from when to when an object is there."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeAlias

import bpy
import numpy as np

from ...core.geometry import BoolArray, FloatArray, Trajectory
from ...editing.motion.keys import continuous, dense, hidden_keys
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import SAME_SHAPE

LINEAR, CONSTANT = 1, 0
"""Numbers of Blender's interpolations, as `foreach_set` takes them."""

Curves: TypeAlias = "bpy.types.bpy_prop_collection | tuple[()]"


def fcurves_of(obj: bpy.types.Object, name: str) -> bpy.types.bpy_prop_collection:
    """The empty curves of a new action of ``obj``. An action of its own that it had is thrown away."""
    data = obj.animation_data_create()
    before, data.action = data.action, None
    if before is not None and before.users == 0:
        bpy.data.actions.remove(before)
    data.action = action = bpy.data.actions.new(name)
    if not hasattr(action, "slots"):  # before Blender 4.4
        return action.fcurves
    slot = action.slots.new(id_type="OBJECT", name=obj.name)
    data.action_slot = slot
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True).fcurves


def add_keys(
    curves: bpy.types.bpy_prop_collection, path: str, frames: FloatArray, values: FloatArray, interpolation: int
) -> None:
    """Add keys of one property at frames (K,): values (K, C), a curve for each of its members; (K,) for a property of
    one."""
    assert len(values) == len(frames), f"values of shape {values.shape} at {len(frames)} frames"
    for index, column in enumerate(np.atleast_2d(values.T)):
        curve = curves.new(path, index=index)
        curve.keyframe_points.add(len(frames))
        curve.keyframe_points.foreach_set("co", np.stack([frames, column], -1).astype(np.float32).ravel())
        curve.keyframe_points.foreach_set("interpolation", np.full(len(frames), interpolation, np.int32))
        curve.extrapolation = "LINEAR" if interpolation == LINEAR else "CONSTANT"
        curve.update()


def curves_of(obj: bpy.types.Object) -> Curves:
    """The curves that move an object; none where it has no action."""
    data = obj.animation_data
    if data is None or data.action is None:
        return ()
    return _curves(data.action, getattr(data, "action_slot", None))


def _curves(action: bpy.types.Action, slot: object) -> Curves:
    if not hasattr(action, "slots"):  # before Blender 4.4
        return action.fcurves
    if slot is None or not action.layers:
        return ()
    bag = action.layers[0].strips[0].channelbag(slot)
    return () if bag is None else bag.fcurves


def shown_by_keys(obj: bpy.types.Object, frames: FloatArray) -> BoolArray:
    """Return at which frames (N,) an object's keys let it be present."""
    hides = [curve for curve in curves_of(obj) if curve.data_path == "hide_viewport"]
    return np.array([all(curve.evaluate(frame) < 0.5 for curve in hides) for frame in frames], bool)


def keys_hide(obj: bpy.types.Object) -> bool:
    """Whether keys, of its action or of a strip of the NLA, say when an object is there."""
    data = obj.animation_data
    strips = [strip for track in data.nla_tracks for strip in track.strips if strip.action] if data is not None else []
    groups = [curves_of(obj), *(_curves(strip.action, getattr(strip, "action_slot", None)) for strip in strips)]
    return any(curve.data_path == "hide_viewport" for curves in groups for curve in curves)


def scale_changes(obj: bpy.types.Object) -> bool:
    """Whether keys make the scale of an object, or of what it is parented to, another at one time than at another."""
    for curve in curves_of(obj):
        values = [key.co[1] for key in curve.keyframe_points] if curve.data_path in ("scale", "delta_scale") else []
        if values and not curve.mute and max(values) - min(values) > SAME_SHAPE * max(map(abs, values)):
            return True
    return obj.parent is not None and scale_changes(obj.parent)


def keyed_values(obj: bpy.types.Object, path: str, frames: Iterable[float]) -> FloatArray:
    """Return a property of an object at frames (N,) by its keys (N, C); members without keys are as they are now."""
    curves = {curve.array_index: curve for curve in curves_of(obj) if curve.data_path == path}
    frames = list(frames)
    columns = [
        [curves[i].evaluate(frame) for frame in frames] if i in curves else [value] * len(frames)
        for i, value in enumerate(getattr(obj, path))
    ]
    return np.array(columns, float).T


def keys_of(obj: bpy.types.Object) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Frames (K,), locations (K, 3) and unit quaternions wxyz (K, 4) of the keys that move an object;
    None without keys."""
    moving = [curve for curve in curves_of(obj) if curve.data_path in ("location", "rotation_quaternion")]
    frames = np.unique([key.co[0] for curve in moving for key in curve.keyframe_points])
    if len(frames) == 0:
        return None
    quaternions = keyed_values(obj, "rotation_quaternion", frames)
    return (
        frames,
        keyed_values(obj, "location", frames),
        quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True),
    )


def write_keys(obj: bpy.types.Object, frames: FloatArray, positions: FloatArray, quaternions: FloatArray) -> None:
    """Replace the keys that move an object; what else is animated stays."""
    curves = curves_of(obj)
    if isinstance(curves, tuple):
        curves = fcurves_of(obj, obj.name)
    for curve in [curve for curve in curves if curve.data_path in ("location", "rotation_quaternion")]:
        curves.remove(curve)
    add_keys(curves, "location", frames, positions, LINEAR)
    add_keys(curves, "rotation_quaternion", frames, continuous(quaternions), LINEAR)


FRAMES, VALUES = 0, 1
"""Of keys, which `change_keys` changes."""


def change_keys(curve: bpy.types.FCurve, column: int, change: Callable[[FloatArray], FloatArray]) -> None:
    """Change the frames or the values of a curve's keys, and their handles alike, so that its shape stays."""
    points = curve.keyframe_points
    numbers = np.empty(2 * len(points), np.float32)
    for part in ("co", "handle_left", "handle_right"):
        points.foreach_get(part, numbers)
        numbers[column::2] = change(numbers[column::2].astype(float))
        points.foreach_set(part, numbers)
    curve.update()


def remove_curves(obj: bpy.types.Object, *paths: str) -> None:
    """Delete an object's curves of some properties."""
    curves = curves_of(obj)
    for curve in [curve for curve in curves if curve.data_path in paths]:
        curves.remove(curve)  # type: ignore[union-attr]


def move_curves(source: bpy.types.Object, target: bpy.types.Object, *paths: str) -> None:
    """Move an object's curves of some properties to a new action of another object."""
    new_curves = fcurves_of(target, target.name)
    for curve in [curve for curve in curves_of(source) if curve.data_path in paths]:
        copy = new_curves.new(curve.data_path, index=curve.array_index)
        points = np.empty(2 * len(curve.keyframe_points), np.float32)
        interpolations = np.empty(len(curve.keyframe_points), np.int32)
        curve.keyframe_points.foreach_get("co", points)
        curve.keyframe_points.foreach_get("interpolation", interpolations)
        copy.keyframe_points.add(len(curve.keyframe_points))
        copy.keyframe_points.foreach_set("co", points)
        copy.keyframe_points.foreach_set("interpolation", interpolations)
        copy.extrapolation = curve.extrapolation
        copy.update()
    remove_curves(source, *paths)


def write_presence(obj: bpy.types.Object, clock: Clock, present_s: tuple[float, float] | None) -> None:
    """Replace all keys of an object by those of its presence: outside ``present_s`` it is hidden in the view.

    Hiding it for renders is left to people, who remove it so.
    """
    hidden = hidden_keys(clock, present_s)
    if hidden is None:
        obj.animation_data_clear()
    else:
        add_keys(fcurves_of(obj, obj.name), "hide_viewport", hidden[0], hidden[1], CONSTANT)


def write_trajectory(obj: bpy.types.Object, trajectory: Trajectory, clock: Clock) -> None:
    """Replace all keys of an object by those of a trajectory of two or more keys."""
    trajectory = dense(trajectory, clock)
    curves, frames = fcurves_of(obj, obj.name), clock.frame(trajectory.times_s)
    add_keys(curves, "location", frames, trajectory.positions, LINEAR)
    add_keys(curves, "rotation_quaternion", frames, continuous(trajectory.quaternions_wxyz), LINEAR)
