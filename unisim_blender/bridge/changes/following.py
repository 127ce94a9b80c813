"""Follows what people move with Blender's own tools: completes the change, and says in the status bar what it meant.

Without keys of its own an object is displaced from its trajectory alike at every frame. With auto-keying, its first key
displaces it at that time alone: two more keys, `BLEND_S` before and after, hold the displacement that it had until
then. Further keys are Blender's own. Where an object that has keys is moved without a new one, Blender would drop the
change at the next frame; all its keys are displaced by it instead."""

from __future__ import annotations

from functools import partial

import bpy
import numpy as np
from bpy.app.handlers import persistent
from mathutils import Quaternion

from ...core.geometry import FloatArray
from ...editing.motion.keys import BLEND_S, SAME
from ...editing.sampled.clock import Clock
from ...translations import localized, message
from ..objects.animation import VALUES, change_keys, curves_of, keyed_values
from ..objects.imported import KINDS_OF_DRIVE, drive_of, has_drive, imported_objects
from ..objects.meshes import scaled_sentence
from ..objects.trajectories import convert, trajectory_of
from .carriers.scale import stand

POLL_S = 0.05
"""Until the next look whether a person has let go of what is dragged."""
DRAG_OPERATORS = ("TRANSFORM_OT", "UNISIM_OT_drag")
"""Prefixes of the names of operators that move objects while a mouse button or a key is pressed."""
READ_OPERATORS = ("UNISIM_OT_export", "UNISIM_OT_render", "UNISIM_OT_check")
"""Prefixes of the names of operators that read whole scenes in steps, between which nothing may change."""
STATUS_TEXT_S = 6.0
"""Duration of a sentence in the status bar."""
_changed: dict[str, set[str]] = {}
"""Names of objects that were moved since the frame was reached, by scene."""
_unsettled: set[tuple[str, str]] = set()
"""Scenes and objects whose change is to be completed."""
_frames: dict[str, float] = {}
"""The frame that each scene was last evaluated at."""
REST_PROPERTIES = {"location": "rest_location", "rotation_quaternion": "rest_rotation"}
"""Properties that displace an object, and those that store its displacement before its first key."""


def dragging() -> bool:
    """Return whether some window is in the middle of moving something, or of reading a scene."""
    windows = bpy.context.window_manager.windows if bpy.context.window_manager is not None else ()
    return any(
        operator.bl_idname.startswith(DRAG_OPERATORS + READ_OPERATORS)
        for window in windows
        for operator in window.modal_operators
    )


def say(sentence: str) -> None:
    """Show a sentence in the status bar for some seconds."""
    for window in bpy.context.window_manager.windows:
        window.workspace.status_text_set(sentence)
    if bpy.app.timers.is_registered(_hush):
        bpy.app.timers.unregister(_hush)
    bpy.app.timers.register(_hush, first_interval=STATUS_TEXT_S)


def _hush() -> None:
    for window in bpy.context.window_manager.windows:
        window.workspace.status_text_set(None)


@persistent
def note_changes(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Note what moved on its trajectory, and complete the change as soon as nothing is dragged."""
    if depsgraph is None or not scene.unisim.log or bpy.app.is_job_running("RENDER"):
        return
    for update in depsgraph.updates:
        obj = update.id.original
        if update.is_updated_transform and isinstance(obj, bpy.types.Object) and obj.unisim.kind in KINDS_OF_DRIVE:
            _changed.setdefault(scene.name, set()).add(obj.name)
            if trajectory_of(obj) is not None or _is_resized(obj):
                _unsettled.add((scene.name, obj.name))
    if _unsettled and not bpy.app.timers.is_registered(_settle):
        bpy.app.timers.register(_settle, first_interval=0.0)


def renamed(scene: bpy.types.Scene, names: dict[str, str]) -> None:
    """Go on following objects that have new names, given by the old ones."""
    changed = _changed.get(scene.name, set())
    for old, new in names.items():
        if old in changed:
            changed.remove(old)
            changed.add(new)
        if (scene.name, old) in _unsettled:
            _unsettled.remove((scene.name, old))
            _unsettled.add((scene.name, new))


def settle_now() -> list[str]:
    """Complete all changes that were noted; return what they meant."""
    said = []
    for name, of in sorted(_unsettled):
        scene = bpy.data.scenes.get(name)
        obj = scene.objects.get(of) if scene is not None else None
        if scene is None or obj is None:
            continue
        if sentence := settle(scene, obj):
            said.append(sentence)
        if obj.unisim.kind == "ACTOR" and stand(obj):
            said.append(localized(scaled_sentence(obj)))
    _unsettled.clear()
    return said


def _is_resized(obj: bpy.types.Object) -> bool:
    """Return whether an actor has another scale than was noted of it."""
    return obj.unisim.kind == "ACTOR" and tuple(obj.scale) != tuple(obj.unisim.rest_scale)


def _settle() -> float | None:
    if dragging():
        return POLL_S
    said = settle_now()
    if said:
        say(
            said[0]
            if len(said) == 1
            else message("{sentence} (and {count} more)", sentence=said[0], count=len(said) - 1)
        )
    return None


@persistent
def keep_changes(scene: bpy.types.Scene, *_: object) -> None:
    """Another frame is about to be shown: changes without a key of objects that have keys would be lost."""
    changed = _changed.pop(scene.name, set())
    frame = _frames.get(scene.name)
    if frame is None or not changed or bpy.app.is_job_running("RENDER"):
        return
    layers = scene.view_layers
    for name in sorted(changed):
        obj = scene.objects.get(name)
        if obj is not None and any(obj.visible_get(view_layer=layer) for layer in layers):
            sentence = keep(scene, obj, frame)
            if sentence and not bpy.app.background:
                say(sentence)


@persistent
def note_frame(scene: bpy.types.Scene, *_: object) -> None:
    """Remember the frame that is shown; what moved on the way to it is no change."""
    _frames[scene.name] = scene.frame_current_final
    _changed.pop(scene.name, None)


@persistent
def look_again(*_: object) -> None:
    """Another file, or another state of this one: bring objects of earlier versions up to date, and begin to follow."""
    _changed.clear()
    _unsettled.clear()
    for scene in getattr(bpy.data, "scenes", ()):  # there are none yet while the extension is switched on
        _frames[scene.name] = scene.frame_current_final
        if not has_drive(scene):
            continue
        if not scene.unisim.trajectories:
            for obj in [obj for obj in scene.objects if obj.unisim.kind in KINDS_OF_DRIVE]:
                convert(obj)
            scene.unisim.trajectories = True
        for obj in displaced_objects(scene):
            settle(scene, obj)
        for obj in imported_objects(scene, "ACTOR"):
            stand(obj)


HANDLERS = (
    ("depsgraph_update_post", note_changes),
    ("frame_change_pre", keep_changes),
    ("frame_change_post", note_frame),
    *((name, look_again) for name in ("load_post", "undo_post", "redo_post")),
)
TIMERS = (_settle, _hush)


register = look_again


def unregister() -> None:
    """Forget what changed."""
    _changed.clear()
    _unsettled.clear()
    _frames.clear()


def settle(scene: bpy.types.Scene, obj: bpy.types.Object) -> str:
    """Complete a change of an object that rides on a trajectory. Return what it meant as a sentence, "" where
    nothing changed."""
    if trajectory_of(obj) is None:
        return ""
    curves = curves_of(obj)
    said = ""
    blended = False
    for path, rest in REST_PROPERTIES.items():
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
    for path in REST_PROPERTIES:
        keyed = {curve.array_index: curve for curve in curves if curve.data_path == path}
        now, then = np.array(getattr(obj, path)), keyed_values(obj, path, [frame])[0]
        if not keyed or np.abs(now - then).max() <= SAME * max(1.0, float(np.abs(then).max())):
            continue
        changed = True
        if path == "location":
            for i, curve in keyed.items():
                change_keys(curve, VALUES, partial(np.add, now[i] - then[i]))
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
            change_keys(curve, VALUES, partial(np.multiply, now / then))
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
    drive = drive_of(scene)
    if drive is None:
        away = seconds * scene.render.fps / scene.render.fps_base
        return frame - away, frame + away
    clock = Clock.of(drive)
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
