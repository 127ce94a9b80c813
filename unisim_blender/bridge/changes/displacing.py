"""Effect of a change of an object's own transform on its trajectory: the whole of it is displaced, or
a stretch of it.

Without keys of its own an object is displaced from its trajectory alike at every frame. With auto-keying, its first key
displaces it at that time alone: two more keys, `BLEND_S` before and after, hold the displacement that it had until
then. Further keys are Blender's own. Where an object that has keys is moved without a new one, Blender would drop the
change at the next frame; all its keys are displaced by it instead.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Quaternion

from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...editing.motion.keys import BLEND_S, SAME
from ...editing.sampled.clock import Clock
from ...translations import message
from ..objects.animation import add_to_keys, curves_of
from ..objects.imported import KINDS_OF_DRIVE
from ..objects.source import source_of
from ..objects.trajectories import trajectory_of

CHANNELS = {"location": "rest_location", "rotation_quaternion": "rest_rotation"}
"""Properties that displace an object, and those that store its displacement before its first key."""


def settle(scene: bpy.types.Scene, obj: bpy.types.Object) -> str:
    """Complete a change of an object that rides on a trajectory. Return what it meant as a sentence, "" where
    nothing changed."""
    if trajectory_of(obj) is None:
        return ""
    curves = curves_of(obj)
    said = ""
    blended = False
    for path, rest in CHANNELS.items():
        keyed = [curve for curve in curves if curve.data_path == path]
        before, now = np.array(getattr(obj.unisim, rest)), np.array(getattr(obj, path))
        if not keyed:
            if np.abs(now - before).max() <= SAME:
                continue
            if _keys_what_is_animated(scene):
                obj.keyframe_insert(path, frame=scene.frame_current)
                blended |= _blend(scene, [curve for curve in curves_of(obj) if curve.data_path == path], before)
            else:
                setattr(obj.unisim, rest, now)
                mounted = obj.unisim.kind in ("CAMERA", "LIDAR")
                said = message(
                    "{name}: its mount is changed" if mounted else "{name}: the whole trajectory is displaced",
                    name=obj.name,
                )
        elif scene.tool_settings.use_keyframe_insert_auto and all(len(curve.keyframe_points) == 1 for curve in keyed):
            blended |= _blend(scene, keyed, before)
    if blended:
        frame = scene.frame_current
        return message(
            "{name}: the change is keyed at frame {frame} and blends in from {blend:g} s before to {blend:g} s after it",
            name=obj.name,
            frame=frame,
            blend=BLEND_S,
        )
    return said


def _keys_what_is_animated(scene: bpy.types.Scene) -> bool:
    """Return whether auto-keying is on, but for what has keys alone, as from Blender 5.2 on at first: an object on a
    trajectory is animated to a person, though the keys are its parent's."""
    settings = scene.tool_settings
    only_available = bpy.context.preferences.edit.use_keyframe_insert_available
    return settings.use_keyframe_insert_auto and settings.auto_keying_mode == "ADD_REPLACE_KEYS" and only_available


def keep(scene: bpy.types.Scene, obj: bpy.types.Object, frame: float) -> str:
    """Displace the keys of an object by the change that was made without a key at ``frame``, which is about to be left.

    Return what was done as a sentence, "" where there was no such change.
    """
    if trajectory_of(obj) is None:
        return ""
    curves = curves_of(obj)
    changed = False
    for path in CHANNELS:
        keyed = {curve.array_index: curve for curve in curves if curve.data_path == path}
        now = np.array(getattr(obj, path))
        then = np.array([keyed[i].evaluate(frame) if i in keyed else value for i, value in enumerate(now)])
        if not keyed or np.abs(now - then).max() <= SAME * max(1.0, float(np.abs(then).max())):
            continue
        changed = True
        if path == "location":
            for i, curve in keyed.items():
                add_to_keys(curve, float(now[i] - then[i]))
        elif len(keyed) == 4:
            _turn([keyed[i] for i in range(4)], Quaternion(now).normalized() @ Quaternion(then).normalized().inverted())
    if changed:
        return message("{name}: the whole trajectory and its keys are displaced", name=obj.name)
    return message("{name}: the scale changes at all its keys", name=obj.name) if _keep_scale(obj, frame) else ""


def _keep_scale(obj: bpy.types.Object, frame: float) -> bool:
    """Scale what the keys of an object's scale say as it was scaled without a key at ``frame``;
    return whether it was."""
    scaled = False
    for curve in (curve for curve in curves_of(obj) if curve.data_path == "scale"):
        now, then = float(obj.scale[curve.array_index]), float(curve.evaluate(frame))
        if abs(now - then) > SAME and then != 0.0:
            scaled = True
            for key in curve.keyframe_points:
                for part in (key.co, key.handle_left, key.handle_right):
                    part[1] *= now / then
            curve.update()
    return scaled


def displaced_objects(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the objects of the drive that ride on trajectories."""
    return [obj for obj in scene.objects if obj.unisim.kind in KINDS_OF_DRIVE and trajectory_of(obj) is not None]


def _blend(scene: bpy.types.Scene, keyed: list[bpy.types.FCurve], before: FloatArray) -> bool:
    """Hold what was ``before`` on both sides of the only key of each curve."""
    for curve in keyed:
        frame = curve.keyframe_points[0].co[0]
        for other in around(scene, frame, BLEND_S):
            key = curve.keyframe_points.insert(other, before[curve.array_index], options={"FAST"})
            key.interpolation = "BEZIER"
        for key in curve.keyframe_points:
            key.handle_left_type = key.handle_right_type = "AUTO_CLAMPED"
        curve.update()
    return bool(keyed)


def around(scene: bpy.types.Scene, frame: float, seconds: float) -> tuple[float, float]:
    """Return the frames that lie some seconds of the log before and after ``frame``; by Blender's rate where
    there is no log."""
    try:
        clock = Clock.of(source_of(scene).drive)
    except (UnisimError, OSError):
        away = seconds * scene.render.fps / scene.render.fps_base
        return frame - away, frame + away
    now = float(clock.time_s(np.array(frame)))
    first, last = clock.frame(np.array([now - seconds, now + seconds]))
    return float(first), float(last)


def _turn(curves: list[bpy.types.FCurve], turn: Quaternion) -> None:
    """Turn the rotations at the keys that all four curves have."""
    frames = sorted({key.co[0] for key in curves[0].keyframe_points})
    values = [turn @ Quaternion([curve.evaluate(frame) for curve in curves]).normalized() for frame in frames]
    for i, curve in enumerate(curves):
        for frame, value in zip(frames, values, strict=True):
            curve.keyframe_points.insert(frame, value[i], options={"FAST"})
        curve.update()
