"""Boxes followed by the worker: Track This, keys that a person sets, and the points about a box."""

from __future__ import annotations

import json
import queue
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...bridge.importing.tracks import (
    displaced,
    drawn_of,
    place_track,
    pose_now,
    settle,
    size_now,
    track_of,
    tracks_in,
)
from ...bridge.objects.imported import source_of
from ...bridge.sampling.stepping import frame_of
from ...bridge.window import Need, chosen, drive, object_mode, redraw, refresh, run_soon, selected
from ...core.errors import UnisimError
from ...core.geometry import Trajectory
from ...core.tracks.box_file import Track
from ...core.world.box_tracks import HALF_FRAME_S, spread_keys
from ...core.world.drive import Actor, Appearance
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


def set_key(obj: bpy.types.Object, scene: bpy.types.Scene, clock: Clock) -> int | None:
    """Note where a box is now as a key that a person set, in place of one at this frame; return its number where it is the
    first one of a box that was never followed."""
    frame = frame_of(scene)
    time_s = float(clock.time_s(np.array(float(frame))))
    drawn = drawn_of(obj)
    there = [key for key in drawn if abs(float(clock.frame(np.array(key[0]))) - frame) >= HALF_FRAME]
    if len(drawn) > len(there):  # it was drawn around the returns of this frame: it keeps their time
        time_s = min((key[0] for key in drawn if key not in there), key=lambda time: abs(time - time_s))
        if not displaced(obj):
            return None
    about = obj.unisim_track
    pose = pose_now(obj)
    there = sorted([*there, (time_s, pose.ravel().tolist())])
    about.drawn = json.dumps(there)
    fresh = not drawn and not about.followed and obj.unisim_track.source == "person"
    return 0 if fresh else None


def ask(scene: bpy.types.Scene, obj: bpy.types.Object, fresh: int | None) -> None:
    """Ask the worker to follow a box from its keys."""
    source, about = source_of(scene), obj.unisim_track
    key = scene.name, obj.unisim.uid
    before = following.pop(key, None)
    if before is not None:
        before.worker.cancel(before.request)
    worker = client(interpreter())
    drawn = drawn_of(obj)
    request = worker.ask(
        "follow",
        log=str(source.log_path),
        size_m=size_now(obj).tolist(),
        label=about.label,
        drawn=drawn,
        fresh=fresh,
        before=json.loads(about.followed) if about.followed else None,
        refine=scene.unisim_tracks.refine and len(drawn) == 1,
    )
    following[key] = Waiting(worker, request, about.drawn)
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
                take(scene, obj, event["result"])
                if not bpy.app.background:
                    bpy.ops.ed.undo_push(message="Track This")
        else:
            del following[key]
            manager.unisim_following = event.get("text", "")
        redraw("VIEW_3D")
    return POLL_S if following else None


def take(scene: bpy.types.Scene, obj: bpy.types.Object, result: dict[str, Any]) -> None:
    """Let a box go where it was followed to."""
    source, about = source_of(scene), obj.unisim_track
    times, poses = np.array(result["times_s"]), np.array(result["poses"]).reshape(-1, 4, 4)
    keys = spread_keys(times) if result["is_moving"] else [0]
    path = Trajectory.from_poses(times[keys], poses[keys])
    uid = obj.unisim.uid
    settle(obj)
    actor = Actor(
        uid, about.label, np.array(result["size_m"]), path, float(times[0]) - HALF_FRAME_S, float(times[-1]) + HALF_FRAME_S,
        len(keys) > 1, Appearance(uid),
    )  # fmt: skip
    about.drawn, about.followed = json.dumps(result["boxes"]), json.dumps(result)
    seen = np.array(result["returns"])
    about.returns, about.sweeps, about.certainty = int(seen.sum()), int((seen > 0).sum()), 1.0
    place_track(obj, actor, source.drive)
    refresh([obj])


class UNISIM_OT_track_this(EditsObjects, bpy.types.Operator):
    """Follow the selected boxes through the sweeps from where they are now; where keys are there, only beside this one"""

    bl_label = "Track This"
    needs = (object_mode, drive, selected("Select a box first: draw one or find actors", "TRACK"))

    def edit(self, context: bpy.types.Context) -> None:
        scene = context.scene
        clock = Clock.of(source_of(scene).drive)
        for obj in chosen(context, "TRACK"):
            ask(scene, obj, set_key(obj, scene, clock))
            if bpy.app.background and context.window_manager.unisim_following:
                raise UnisimError(context.window_manager.unisim_following)


class UNISIM_OT_keep_box(EditsObjects, bpy.types.Operator):
    """Note that the selected boxes are right at this frame: what is corrected beside it ends here"""

    bl_label = "Keep Here"
    needs = (object_mode, drive, selected("Select a box first: draw one or find actors", "TRACK"))

    def edit(self, context: bpy.types.Context) -> None:
        scene = context.scene
        clock = Clock.of(source_of(scene).drive)
        for obj in chosen(context, "TRACK"):
            if displaced(obj):
                raise UnisimError(message("{name}: was moved here; Track This follows it from there", name=obj.name))
            set_key(obj, scene, clock)
            about = obj.unisim_track
            result = json.loads(about.followed) if about.followed else as_followed(track_of(obj, clock))
            about.followed = json.dumps({**result, "boxes": drawn_of(obj)})


def as_followed(track: Track) -> dict[str, Any]:
    """Return a track as the result of following it."""
    path, actor = track.actor.world_from_actor, track.actor
    count = len(path.times_s)
    return {
        "times_s": path.times_s.tolist(),
        "poses": path.poses.reshape(-1, 16).tolist(),
        "certainty": [track.certainty] * count,
        "returns": [0] * count,
        "is_moving": bool(actor.is_moving),
        "size_m": np.asarray(actor.size_m).tolist(),
    }


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
