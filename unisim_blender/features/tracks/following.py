"""Boxes followed by the worker: Track This, keys that a person sets, and the points about a box."""

from __future__ import annotations

import json
import queue
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ...bridge.importing.tracks import (
    displaced,
    drawn_of,
    pose_now,
    set_track,
    track_of,
    tracks_in,
)
from ...bridge.objects.imported import source_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.window import Need, chosen, drive, object_mode, redraw, refresh, run_soon, selected
from ...core.errors import UnisimError
from ...core.tracks.box_file import Track, track_from_json, track_to_json
from ...editing.sampled.clock import Clock
from ...preferences import interpreter
from ...process.client import Client, Request, client, progress_line
from ...translations import message
from ..operator_bases import EditsObjects, Needing

POLL_S = 0.1
HALF_FRAME = 0.5
"""Part of a frame within which a key is the one that is there."""


@dataclass
class Waiting:
    """A box that is followed: the worker, the request, and the keys that it was asked with."""

    worker: Client
    request: Request
    drawn: str


following: dict[tuple[str, str], Waiting] = {}
"""By scene and id of the box."""


def set_key(obj: bpy.types.Object, scene: bpy.types.Scene, clock: Clock) -> None:
    """Note where a box is now as a key that a person set, in place of one at this frame."""
    frame = frame_of(scene)
    time_s = float(clock.time_s(np.array(float(frame))))
    drawn = drawn_of(obj)
    there = [key for key in drawn if abs(float(clock.frame(np.array(key[0]))) - frame) >= HALF_FRAME]
    if len(drawn) > len(there):  # it was drawn around the returns of this frame: it keeps their time
        time_s = min((key[0] for key in drawn if key not in there), key=lambda time: abs(time - time_s))
        if not displaced(obj):
            return
    obj.unisim_track.drawn = json.dumps(sorted([*there, (time_s, pose_now(obj).ravel().tolist())]))


def ask(scene: bpy.types.Scene, obj: bpy.types.Object, track: Track, fresh: int | None) -> None:
    """Ask the worker to follow a box from its keys; ``track`` is what it was before the newest one, ``fresh`` the number of
    one that was drawn around a sweep's returns."""
    source = source_of(scene)
    key = scene.name, obj.unisim.uid
    before = following.pop(key, None)
    if before is not None:
        before.worker.cancel(before.request)
    worker, drawn = client(interpreter()), drawn_of(obj)
    if np.abs(np.array(obj.scale) - 1).max() > 1e-5:  # of another size, every span is followed again
        track = replace(track, drawn_s=())
    refine = scene.unisim_tracks.refine and len(drawn) == 1
    request = worker.ask(
        "follow", log=str(source.log_path), track=track_to_json(track), drawn=drawn, fresh=fresh, refine=refine
    )
    following[key] = Waiting(worker, request, obj.unisim_track.drawn)
    while bpy.app.background and following:
        gather()
    run_soon(gather, POLL_S)


def gather() -> float | None:
    """Take what has come of boxes that are followed; as a timer of Blender's, until all have ended."""
    for key, waiting in list(following.items()):
        try:
            event = waiting.request.events.get(timeout=POLL_S if bpy.app.background else 0.0001)
        except queue.Empty:
            continue
        manager, scene = bpy.context.window_manager, bpy.data.scenes.get(key[0])
        if event["event"] == "progress":
            manager.unisim_following = progress_line(event)
        elif event["event"] == "followed":
            obj = None if scene is None else next((one for one in tracks_in(scene) if one.unisim.uid == key[1]), None)
            if obj is not None and obj.unisim_track.drawn == waiting.drawn:  # nothing was undone meanwhile
                track = track_from_json(event["track"], "the followed box")
                set_track(obj, track, source_of(scene).drive)
                refresh([obj])
                if not bpy.app.background:
                    bpy.ops.ed.undo_push(message="Track This")
        else:
            del following[key]
            manager.unisim_following = event.get("text", "")
        redraw("VIEW_3D")
    return POLL_S if following else None


selected_boxes = selected("Select a box first: draw one or find actors", "TRACK")


class SetsKeys(EditsObjects):
    """What sets a key of the selected boxes at this frame."""

    needs = (object_mode, drive, selected_boxes)

    def edit(self, context: bpy.types.Context) -> None:
        clock = Clock.of(source_of(context.scene).drive)
        for obj in chosen(context, "TRACK"):
            self.set(context.scene, obj, clock)

    def set(self, scene: bpy.types.Scene, obj: bpy.types.Object, clock: Clock) -> None:
        """Set the key of a box."""
        raise NotImplementedError


class UNISIM_OT_track_this(SetsKeys, bpy.types.Operator):
    """Follow the selected boxes through the sweeps from where they are now; where keys are there, only beside this one"""

    bl_label = "Track This"

    def set(self, scene: bpy.types.Scene, obj: bpy.types.Object, clock: Clock) -> None:
        track = track_of(obj, clock, displaced=False)
        fresh = 0 if track.source == "person" and not track.drawn_s else None
        set_key(obj, scene, clock)
        ask(scene, obj, track, fresh)
        if bpy.app.background and (told := bpy.context.window_manager.unisim_following):
            raise UnisimError(told)


class UNISIM_OT_keep_box(SetsKeys, bpy.types.Operator):
    """Note that the selected boxes are right at this frame: what is corrected beside it ends here"""

    bl_label = "Keep Here"

    def set(self, scene: bpy.types.Scene, obj: bpy.types.Object, clock: Clock) -> None:
        if displaced(obj):
            raise UnisimError(message("{name}: was moved here; Track This follows it from there", name=obj.name))
        set_key(obj, scene, clock)


class UNISIM_OT_stop_tracking(Needing, bpy.types.Operator):
    """Stop following boxes; they stay as they are"""

    bl_label = "Stop Tracking"
    bl_options = {"REGISTER"}

    @staticmethod
    def is_following(context: bpy.types.Context) -> Need:
        """A box is followed."""
        return following, "No box is followed"

    needs = (is_following,)

    def execute(self, context: bpy.types.Context) -> set[str]:
        for waiting in following.values():
            waiting.worker.cancel(waiting.request)
        return {"FINISHED"}


TIMERS = (gather,)


def unregister() -> None:
    """Forget what was asked for."""
    following.clear()
