"""Brings edits lists up to date: notes changes, and reads again in steps of some milliseconds as soon as nothing
is dragged."""

from __future__ import annotations

import time
import traceback
from collections.abc import Iterator

import bpy
from bpy.app.handlers import persistent

from ...bridge.changes.following import dragging
from ...bridge.objects.imported import has_drive
from ...bridge.sampling import edit_list
from ...bridge.sampling.adjacent_frames import BESIDE_SCENE
from ...bridge.window import areas, run_soon
from ...editing.texts import Text

BUDGET_S = 0.012
"""Processor time for which a list is read before the window goes on."""
LATEST_S = 0.05
"""The same as the clock has it, where other programs keep the processor busy."""
TICK_S = 0.01
WAIT_S = 0.15
"""Until the next look whether a list may be read."""
QUIET_S = 0.15
"""Time after the last change at which a list is read, in seconds."""
OWN_S = 0.5
"""Time after a scene beside was made in which updates without a transform are taken to be of that scene, in seconds."""

_changed_s = 0.0
_beside_s = 0.0
_at: list[tuple[str, Iterator[None]]] = []
"""The scene that is being read, and what is left to do."""


def want() -> None:
    """Have the edits of all scenes read that are not known; called while panels are drawn."""
    if any(not edit_list.reading_of(scene).fresh for scene in _scenes()):
        run_soon(_read, TICK_S)


def _scenes() -> list[bpy.types.Scene]:
    """Return the scenes that windows show, and then the others with the same drives."""
    shown = [window.scene for window in bpy.context.window_manager.windows if window.scene.unisim.log]
    logs = {scene.unisim.log for scene in shown}
    beside = [
        scene for scene in bpy.data.scenes if scene not in shown and scene.unisim.log in logs and has_drive(scene)
    ]
    return [*shown, *beside]


def _read() -> float | None:
    """Read for some milliseconds; as a timer of Blender's, until all is read."""
    global _beside_s
    if dragging() or bpy.app.is_job_running("RENDER") or time.monotonic() - _changed_s < QUIET_S:
        return WAIT_S
    until, latest = time.thread_time() + BUDGET_S, time.monotonic() + LATEST_S
    while time.thread_time() < until and time.monotonic() < latest:
        scene = next((shown for shown in _scenes() if not edit_list.reading_of(shown).fresh), None)
        if scene is None:
            _redraw()
            return None
        if not _at or _at[0][0] != scene.name or edit_list.reading_of(scene).stale:
            _at[:] = [(scene.name, edit_list.read_steps(scene))]
        try:
            next(_at[0][1])
        except StopIteration:
            _at.clear()
            _redraw()
        except ReferenceError:  # something was deleted meanwhile
            edit_list.reading_of(scene).mark()
        except Exception as fault:  # Blender drops a timer that fails, and the panel would wait for ever
            traceback.print_exc()
            edit_list.reading_of(scene).fail(Text("The edits cannot be read: {fault}", fault=str(fault)))
            _at.clear()
        if edit_list.consume_beside_flag():
            _beside_s = time.monotonic()
    return TICK_S


def _redraw() -> None:
    """Draw the panels: those ask for lists to be read, and those that are not drawn again must show it."""
    for area in areas("VIEW_3D"):
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()


@persistent
def note_changes(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Note that a scene changed."""
    global _changed_s
    if scene.name == BESIDE_SCENE or not scene.unisim.log or bpy.app.is_job_running("RENDER"):
        return
    updates = depsgraph.updates if depsgraph is not None else ()
    moved = any(
        isinstance(update.id, bpy.types.Object) and (update.is_updated_transform or update.is_updated_geometry)
        for update in updates
    )
    now = time.monotonic()
    edit_list.reading_of(scene).mark(moved=moved or now - _beside_s > OWN_S)
    _changed_s = now
    run_soon(_redraw)


@persistent
def look_again(*_: object) -> None:
    """Another file, or another state of this one."""
    edit_list.mark_all()
    _at.clear()
    run_soon(_redraw)


@persistent
def forget(*_: object) -> None:
    """Another file: nothing is known of it."""
    edit_list.forget()
    look_again()


HANDLERS = (
    ("depsgraph_update_post", note_changes),
    ("load_post", forget),
    ("undo_post", look_again),
    ("redo_post", look_again),
)
TIMERS = (_read, _redraw)


register = forget
