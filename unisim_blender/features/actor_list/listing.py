"""Keeps the values of all actors at hand for the actor list and the presence timeline, so that drawing
works nothing out.

Handlers note which actors changed; a timer brings their tracks up to date, a few at a time, and values at each new
frame. Nothing of it is in the file: undo, renaming and deletion leave nothing behind.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...bridge.objects.imported import has_drive, imported_objects, originals, source_of
from ...bridge.objects.trajectories import keyed_poses
from ...bridge.views.actors import track_of
from ...bridge.window import redraw, run_soon
from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...editing.actors.table import ActorFilter, ActorTrack, Entry, chosen_entries, values_at
from ...editing.sampled.clock import Clock

BUSY_S = 0.02
"""Time for which a turn of the timer works on tracks, in seconds."""
REST_S, WAIT_S = 0.02, 0.1
"""Time between two turns, and until the next look while the window has other work, in seconds."""
KINDS = ("ACTOR", "TRAJECTORY", "EGO")


@dataclass
class ActorListing:
    """The actors of one scene: ``tracks`` by the objects' session ids, ``entries`` as they are at frame ``frame``, and
    those that the filter lets through in ``shown``. ``places`` are positions in ``scene.objects``, where the list finds
    its rows, and ``own`` are the names of the objects that stand for recorded actors, by id."""

    tracks: dict[int, ActorTrack] = field(default_factory=dict)
    stale: set[int] = field(default_factory=set)
    ego: FloatArray = field(default_factory=lambda: np.zeros((1, 3)))
    clock: Clock | None = None
    entries: dict[int, Entry] = field(default_factory=dict)
    shown: list[Entry] = field(default_factory=list)
    places: dict[int, int] = field(default_factory=dict)
    own: dict[str, str] = field(default_factory=dict)
    frame: float = 0.0
    all_stale: bool = True
    problem: str = ""


_tables: dict[int, ActorListing] = {}
"""By the scenes' session ids."""
_changed: set[int] = set()
"""Scenes of which something is to be brought up to date."""
after: list[Callable[[bpy.types.Scene], None]] = []
"""Called whenever a scene's table was brought up to date."""


def table_of(scene: bpy.types.Scene) -> ActorListing:
    """Return a scene's table as it is; one that is not made yet is empty, and soon comes."""
    table = _tables.get(scene.session_uid)
    if table is None:
        table = _tables[scene.session_uid] = ActorListing()
        refresh_soon(scene)
    return table


def refresh_now(scene: bpy.types.Scene) -> ActorListing:
    """Bring a scene's table up to date at once, and return it."""
    table = table_of(scene)
    _bring_up(scene, table, math.inf)
    _changed.discard(scene.session_uid)
    return table_of(scene)


def filter_of(manager: bpy.types.WindowManager) -> ActorFilter:
    """Return the filter that the list has."""
    about = manager.unisim_actors
    return ActorFilter(about.text, about.group, about.within_m, about.now, about.edited, about.order)


def refilter() -> None:
    """The filter is another one: choose again from what is known."""
    for table in _tables.values():
        table.shown = chosen_entries(list(table.entries.values()), filter_of(bpy.context.window_manager))
    redraw("VIEW_3D")


def _bring_up(scene: bpy.types.Scene, table: ActorListing, busy_s: float) -> bool:
    """Work on a table for some time; return whether it is up to date."""
    until = time.monotonic() + busy_s
    if not has_drive(scene):
        _tables[scene.session_uid] = ActorListing(all_stale=False)
        return True
    try:
        drive = source_of(scene).drive
    except (UnisimError, OSError) as fault:
        _tables[scene.session_uid] = ActorListing(all_stale=False, problem=str(fault))
        return True
    actors = {obj.session_uid: obj for obj in imported_objects(scene, "ACTOR")}
    if table.all_stale:
        table.all_stale, table.stale, table.clock = False, set(actors), Clock.of(drive)
        table.tracks.clear()
    assert table.clock is not None
    own = {uid: obj.name for uid, obj in originals(scene, "ACTOR").items()}
    for key in [key for key in table.tracks if key not in actors]:
        del table.tracks[key]
    for key, obj in actors.items():
        # where the object that stands for a recorded actor is renamed or deleted, a copy may stand for it now
        uid = obj.unisim.uid
        if key not in table.tracks or table.tracks[key].name != obj.name or table.own.get(uid) != own.get(uid):
            table.stale.add(key)
    table.own = own
    for key in list(table.stale):
        if key in actors:
            obj = actors[key]
            table.tracks[key] = track_of(obj, drive, table.clock, not obj.unisim.uid or own[obj.unisim.uid] == obj.name)
        table.stale.discard(key)
        if time.monotonic() > until and table.stale:
            return False
    ego = next(imported_objects(scene, "EGO"), None)
    table.ego = (
        keyed_poses(ego, table.clock.frames)[:, :3, 3] if ego is not None else np.zeros((len(table.clock.frames), 3))
    )
    _show_values(scene, table, actors)
    return True


def _show_values(scene: bpy.types.Scene, table: ActorListing, actors: dict[int, bpy.types.Object]) -> None:
    """Work out the entries at the frame that is shown, and which of them the filter lets through."""
    assert table.clock is not None
    table.frame = float(scene.frame_current_final)
    keys = list(table.tracks)
    values = values_at([table.tracks[key] for key in keys], table.ego, table.clock, table.frame)
    table.entries = {
        key: Entry(
            key, actors[key].name, track.label, track.group, float(values.distance_m[i]), float(values.speed_m_s[i]),
            bool(values.there[i]), track.steps, track.edited, hidden(scene, actors[key]),
        )
        for i, (key, track) in enumerate((key, table.tracks[key]) for key in keys)
    }  # fmt: skip
    table.places = {obj.session_uid: place for place, obj in enumerate(scene.objects)}
    table.shown = chosen_entries(list(table.entries.values()), filter_of(bpy.context.window_manager))
    for call in after:
        call(scene)


def hidden(scene: bpy.types.Scene, obj: bpy.types.Object) -> bool:
    """Return whether a person has hidden an object in the view (H)."""
    layer = bpy.context.view_layer if bpy.context.scene == scene else scene.view_layers[0]
    return obj.name in layer.objects and obj.hide_get(view_layer=layer)


def refresh_soon(scene: bpy.types.Scene) -> None:
    """Have a scene's table brought up to date; without a window nobody looks at it."""
    _changed.add(scene.session_uid)
    run_soon(_turn)


def importing() -> bool:
    """Return whether a drive is being imported: it shall not take longer for the list's sake."""
    windows = bpy.context.window_manager.windows if bpy.context.window_manager is not None else ()
    return any(
        operator.bl_idname.startswith("UNISIM_OT_import") for window in windows for operator in window.modal_operators
    )


def _turn() -> float | None:
    if bpy.app.is_job_running("RENDER") or importing():
        return WAIT_S
    for scene in bpy.data.scenes:
        if scene.session_uid in _changed:
            if not _bring_up(scene, table_of(scene), BUSY_S):
                return REST_S
            _changed.discard(scene.session_uid)
            redraw("VIEW_3D")
    _changed.clear()
    there = {scene.session_uid for scene in bpy.data.scenes}
    for key in [key for key in _tables if key not in there]:
        del _tables[key]
    return None


@persistent
def note_changes(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph | None = None) -> None:
    """Something was evaluated again: note which actors it was."""
    if depsgraph is None or not scene.unisim.log or bpy.app.is_job_running("RENDER"):
        return
    table = table_of(scene)
    for update in depsgraph.updates:
        changed = update.id.original
        if isinstance(changed, bpy.types.Action):
            table.all_stale = True
        elif isinstance(changed, bpy.types.Object) and changed.unisim.kind in KINDS:
            for obj in changed.children if changed.unisim.kind == "TRAJECTORY" else (changed,):
                table.stale.add(obj.session_uid)
    refresh_soon(scene)


@persistent
def note_frame(scene: bpy.types.Scene, *_: object) -> None:
    """Another frame is shown."""
    if scene.unisim.log and not bpy.app.is_job_running("RENDER"):
        refresh_soon(scene)


@persistent
def look_again(*_: object) -> None:
    """Another state of the file: everything may be different. What was shown stays until it is known again."""
    for scene in getattr(bpy.data, "scenes", ()):  # there are none yet while the extension is switched on
        if scene.unisim.log:
            table_of(scene).all_stale = True
            refresh_soon(scene)


@persistent
def start_again(*_: object) -> None:
    """Another file."""
    _tables.clear()
    look_again()


HANDLERS = (
    ("depsgraph_update_post", note_changes),
    ("frame_change_post", note_frame),
    ("load_post", start_again),
    ("undo_post", look_again),
    ("redo_post", look_again),
)
TIMERS = (_turn,)


register = start_again
