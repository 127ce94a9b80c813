"""Trajectories as keyframes: location and quaternion, LINEAR, and from when to when an object is there."""

from __future__ import annotations

from typing import TypeAlias

import bpy
import numpy as np

from ...core.geometry import BoolArray, FloatArray, Trajectory
from ...core.scenario.motion import merged_times, sampled_keys
from ...editing.sampled.clock import Clock
from ...editing.sampled.scaling import SAME_SHAPE

TURN_RAD = 0.02
"""Between two keys: what Blender makes of it is 1e-6 rad off slerp."""
OFF_M = 1e-5
LINEAR, CONSTANT = 1, 0
"""Numbers of Blender's interpolations, as `foreach_set` takes them."""

Curves: TypeAlias = "bpy.types.bpy_prop_collection | tuple[()]"


def fcurves_of(thing: bpy.types.Object, name: str) -> bpy.types.bpy_prop_collection:
    """The empty curves of a new action of ``thing``. An action of its own that it had is thrown away."""
    data = thing.animation_data_create()
    before, data.action = data.action, None
    if before is not None and before.users == 0:
        bpy.data.actions.remove(before)
    data.action = action = bpy.data.actions.new(name)
    if not hasattr(action, "slots"):  # before Blender 4.4
        return action.fcurves
    slot = action.slots.new(id_type="OBJECT", name=thing.name)
    data.action_slot = slot
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    return strip.channelbag(slot, ensure=True).fcurves


def add_keys(
    curves: bpy.types.bpy_prop_collection, path: str, frames: FloatArray, values: FloatArray, interpolation: int
) -> None:
    """Keys of one property at frames (K,): values (K, C), a curve for each of its members; (K,) for a property of one."""
    for index, column in enumerate(np.atleast_2d(values.T)):
        curve = curves.new(path, index=index)
        curve.keyframe_points.add(len(frames))
        curve.keyframe_points.foreach_set("co", np.stack([frames, column], -1).astype(np.float32).ravel())
        curve.keyframe_points.foreach_set("interpolation", np.full(len(frames), interpolation, np.int32))
        curve.extrapolation = "LINEAR" if interpolation == LINEAR else "CONSTANT"
        curve.update()


def curves_of(thing: bpy.types.Object) -> Curves:
    """The curves that move an object; none where it has no action."""
    data = thing.animation_data
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


def shown_by_keys(thing: bpy.types.Object, frames: FloatArray) -> BoolArray:
    """Return at which frames (N,) an object's keys let it be present."""
    hides = [curve for curve in curves_of(thing) if curve.data_path == "hide_viewport"]
    return np.array([all(curve.evaluate(frame) < 0.5 for curve in hides) for frame in frames], bool)


def keys_hide(thing: bpy.types.Object) -> bool:
    """Whether keys, of its action or of a strip of the NLA, say when an object is there."""
    data = thing.animation_data
    strips = [strip for track in data.nla_tracks for strip in track.strips if strip.action] if data is not None else []
    found = [curves_of(thing), *(_curves(strip.action, getattr(strip, "action_slot", None)) for strip in strips)]
    return any(curve.data_path == "hide_viewport" for curves in found for curve in curves)


def scale_changes(thing: bpy.types.Object) -> bool:
    """Whether keys make the scale of an object, or of what it is parented to, another at one time than at another."""
    for curve in curves_of(thing):
        values = [key.co[1] for key in curve.keyframe_points] if curve.data_path in ("scale", "delta_scale") else []
        if values and not curve.mute and max(values) - min(values) > SAME_SHAPE * max(map(abs, values)):
            return True
    return thing.parent is not None and scale_changes(thing.parent)


def keys_of(thing: bpy.types.Object) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Frames (K,), locations (K, 3) and unit quaternions wxyz (K, 4) of the keys that move an object; None without keys."""
    found = {(curve.data_path, curve.array_index): curve for curve in curves_of(thing)}
    moving = [curve for (path, _), curve in found.items() if path in ("location", "rotation_quaternion")]
    frames = np.unique([key.co[0] for curve in moving for key in curve.keyframe_points])
    if len(frames) == 0:
        return None

    def values(path: str, now: FloatArray) -> FloatArray:
        columns = [
            [found[path, i].evaluate(f) for f in frames] if (path, i) in found else [now[i]] * len(frames)
            for i in range(len(now))
        ]
        return np.array(columns, float).T

    quaternions = values("rotation_quaternion", np.array(thing.rotation_quaternion))
    return frames, values("location", np.array(thing.location)), quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)


def write_keys(thing: bpy.types.Object, frames: FloatArray, positions: FloatArray, quaternions: FloatArray) -> None:
    """Replace the keys that move an object; what else is animated stays."""
    curves = curves_of(thing)
    if isinstance(curves, tuple):
        curves = fcurves_of(thing, thing.name)
    for curve in [curve for curve in curves if curve.data_path in ("location", "rotation_quaternion")]:
        curves.remove(curve)
    add_keys(curves, "location", frames, positions, LINEAR)
    add_keys(curves, "rotation_quaternion", frames, continuous(quaternions), LINEAR)


def add_to_keys(curve: bpy.types.FCurve, amount: float) -> None:
    """Add an amount to the values of a curve's keys and to their handles, so that its shape stays."""
    points = curve.keyframe_points
    values = np.empty(2 * len(points), np.float32)
    for part in ("co", "handle_left", "handle_right"):
        points.foreach_get(part, values)
        values[1::2] += amount
        points.foreach_set(part, values)
    curve.update()


def remove_curves(thing: bpy.types.Object, *paths: str) -> None:
    """Delete an object's curves of some properties."""
    curves = curves_of(thing)
    for curve in [curve for curve in curves if curve.data_path in paths]:
        curves.remove(curve)  # type: ignore[union-attr]


def move_curves(source: bpy.types.Object, target: bpy.types.Object, *paths: str) -> None:
    """Move an object's curves of some properties to a new action of another object."""
    kept = fcurves_of(target, target.name)
    for curve in [curve for curve in curves_of(source) if curve.data_path in paths]:
        copy = kept.new(curve.data_path, index=curve.array_index)
        points = np.empty(2 * len(curve.keyframe_points), np.float32)
        ways = np.empty(len(curve.keyframe_points), np.int32)
        curve.keyframe_points.foreach_get("co", points)
        curve.keyframe_points.foreach_get("interpolation", ways)
        copy.keyframe_points.add(len(curve.keyframe_points))
        copy.keyframe_points.foreach_set("co", points)
        copy.keyframe_points.foreach_set("interpolation", ways)
        copy.extrapolation = curve.extrapolation
        copy.update()
    remove_curves(source, *paths)


def write_presence(thing: bpy.types.Object, clock: Clock, present_s: tuple[float, float] | None) -> None:
    """Replace all keys of an object by those of its presence: outside ``present_s`` it is hidden in the view.

    Hiding it for renders is left to people, who remove it so.
    """
    hidden = _hidden_keys(clock, present_s)
    if hidden is None:
        thing.animation_data_clear()
    else:
        add_keys(fcurves_of(thing, thing.name), "hide_viewport", hidden[0], hidden[1], CONSTANT)


def write_trajectory(thing: bpy.types.Object, way: Trajectory, clock: Clock) -> None:
    """Replace all keys of an object by those of a trajectory of two or more keys."""
    way = dense(way, clock)
    curves, frames = fcurves_of(thing, thing.name), clock.frame(way.times_s)
    add_keys(curves, "location", frames, way.positions, LINEAR)
    add_keys(curves, "rotation_quaternion", frames, continuous(way.quaternions_wxyz), LINEAR)


def dense(way: Trajectory, clock: Clock) -> Trajectory:
    """The same way with keys at all frames besides, where Blender would make something else of its own keys alone: it turns by
    other numbers than slerp, and a log's frames are not quite evenly spaced."""
    q = continuous(way.quaternions_wxyz)
    turns = np.abs((q[1:] * q[:-1]).sum(-1)).min() < np.cos(TURN_RAD / 2)
    keys = clock.frame(way.times_s)
    inside = (clock.frames >= keys[0]) & (clock.frames <= keys[-1])
    true = way.at(clock.times_s[inside])
    made = np.stack([np.interp(clock.frames[inside], keys, column) for column in way.positions.T], -1)
    if not turns and np.abs(made - true[:, :3, 3]).max(initial=0.0) < OFF_M:
        return way
    times = merged_times(way.times_s, clock.times_s)
    positions, quaternions = sampled_keys(way, times)
    return Trajectory(times, positions, quaternions)


def _hidden_keys(clock: Clock, present_s: tuple[float, float] | None) -> tuple[FloatArray, FloatArray] | None:
    """Frames and values of `hide_viewport`; None where the object is there at all of the clock's frames."""
    if present_s is None:
        return None
    there = (clock.times_s >= present_s[0]) & (clock.times_s <= present_s[1])
    if there.all():
        return None
    frames, hidden = [clock.frames[0] - 1], [1.0]
    for frame, here in zip(clock.frames, there, strict=True):
        if hidden[-1] != (0.0 if here else 1.0):
            frames.append(frame)
            hidden.append(0.0 if here else 1.0)
    if there[-1]:
        frames.append(clock.frames[-1] + 1)
        hidden.append(1.0)
    return np.array(frames), np.array(hidden)


def continuous(quaternions: FloatArray) -> FloatArray:
    """Quaternions (K, 4) with signs such that neighbours lie on one side: Blender interpolates their numbers."""
    flips = np.where((quaternions[1:] * quaternions[:-1]).sum(-1) < 0, -1.0, 1.0)
    return quaternions * np.concatenate([[1.0], np.cumprod(flips)])[:, None]
