"""Follows what people move with Blender's own tools: completes the change, and says in the status bar what it meant."""

from __future__ import annotations

from contextlib import suppress

import bpy
from bpy.app.handlers import persistent

from ...translations import localized, message
from ..objects.imported import KINDS_OF_DRIVE, has_drive, imported_objects
from ..objects.meshes import scaled_sentence
from ..objects.trajectories import convert, trajectory_of
from .displacing import displaced_objects, keep, settle
from .standing import stand

LOOK_S = 0.05
"""Until the next look whether a person has let go of what is dragged."""
DRAGGING = ("TRANSFORM_OT", "UNISIM_OT_drag")
"""How the names of operators begin that move objects while a mouse button or a key is held."""
READING = ("UNISIM_OT_export", "UNISIM_OT_render", "UNISIM_OT_check")
"""How the names of operators begin that read whole scenes in steps, between which nothing may change."""
SAID_S = 6.0
"""How long the status bar shows a sentence."""

_changed: dict[str, set[str]] = {}
"""Names of objects that were moved since the frame was reached, by scene."""
_unsettled: set[tuple[str, str]] = set()
"""Scenes and objects whose change is to be completed."""
_frames: dict[str, float] = {}
"""The frame that each scene was last evaluated at."""


def dragging() -> bool:
    """Return whether some window is in the middle of moving something, or of reading a scene."""
    windows = bpy.context.window_manager.windows if bpy.context.window_manager is not None else ()
    return any(
        operator.bl_idname.startswith(DRAGGING + READING) for window in windows for operator in window.modal_operators
    )


def say(sentence: str) -> None:
    """Show a sentence in the status bar for some seconds."""
    for window in bpy.context.window_manager.windows:
        window.workspace.status_text_set(sentence)
    if bpy.app.timers.is_registered(_hush):
        bpy.app.timers.unregister(_hush)
    bpy.app.timers.register(_hush, first_interval=SAID_S)


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
        return LOOK_S
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


def _handlers() -> tuple[tuple[list[object], object], ...]:
    handlers = bpy.app.handlers
    return (
        (handlers.depsgraph_update_post, note_changes),
        (handlers.frame_change_pre, keep_changes),
        (handlers.frame_change_post, note_frame),
        *((when, look_again) for when in (handlers.load_post, handlers.undo_post, handlers.redo_post)),
    )


def register() -> None:
    """Begin to follow."""
    for when, handler in _handlers():
        when.append(handler)
    look_again()


def unregister() -> None:
    """Follow no more."""
    for when, handler in _handlers():
        with suppress(ValueError):
            when.remove(handler)
    for timer in (_settle, _hush):
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)
    _changed.clear()
    _unsettled.clear()
    _frames.clear()
