"""Data of each actor for the actor list, the presence timeline and the sidebar.

An actor's track is where its keys put it at all frames of the clock, and when they show it. It is worked out again only
when the actor changed; distance and speed at another frame then take one step for all actors together."""

from __future__ import annotations

from collections.abc import Container

import bpy
import numpy as np

from ...core.actor_images.names import group_of
from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import Drive
from ...editing.actors.table import (
    ActorCard,
    ActorTrack,
    present_span,
    role_words,
    size_words,
    steps_of,
)
from ...editing.motion.kinematics import motion_of
from ...editing.motion.placement import Neighbour
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import UNIT, differs
from ..objects.animation import shown_by_keys
from ..objects.imported import class_of, imported_objects, is_copy
from ..objects.meshes import scale_of, size_of
from ..objects.trajectories import keyed_poses, trajectory_of

NEAR_S = 2.0
"""Frames within this time tell an actor's speed at one."""


def track_of(obj: bpy.types.Object, drive: Drive, clock: Clock, original: bool) -> ActorTrack:
    """Return an actor's track; ``original`` tells whether the object stands for the recorded actor and is no copy."""
    poses, there = keyed_poses(obj, clock.frames), there_of(obj, clock.frames)
    label = class_of(obj, drive)
    return ActorTrack(
        obj.name, obj.unisim.uid, label, group_of(label), poses[:, :3, 3], there,
        motion_of(poses[:, :3, 3], clock.times_s, there).speed_m_s, steps_of(there, clock),
        is_edited(obj, drive, clock, poses, there, original),
    )  # fmt: skip


def is_edited(
    obj: bpy.types.Object, drive: Drive, clock: Clock, poses: FloatArray, there: BoolArray, original: bool
) -> bool:
    """Return whether a scenario would name an actor: it is new, removed, has another appearance, or goes elsewhere or
    at other times than recorded. What constraints, drivers or the NLA do counts as edited unseen."""
    actor = drive.actors.get(obj.unisim.uid)
    if actor is None or not original or obj.unisim.mesh or obj.unisim.look or obj.hide_render:
        return True
    for moved in (obj, trajectory_of(obj)):
        data = moved.animation_data if moved is not None else None
        if moved is not None and (moved.constraints or (data is not None and (data.drivers or data.nla_tracks))):
            return True
    return differs(poses, there, actor, drive, clock)


def there_of(obj: bpy.types.Object, frames: FloatArray) -> BoolArray:
    """Return whether keys show an object at frames (N,), and it is not removed."""
    return shown_by_keys(obj, frames) & (not obj.hide_render)


def neighbours(scene: bpy.types.Scene, new: Container[bpy.types.Object], drive: Drive, clock: Clock) -> list[Neighbour]:
    """Return the actors of a scene beside new ones."""
    actors = [obj for obj in imported_objects(scene, "ACTOR") if obj not in new and not obj.hide_render]
    return [
        Neighbour(keyed_poses(obj, clock.frames), there_of(obj, clock.frames), class_of(obj, drive), size_of(obj))
        for obj in actors
    ]


def ego_poses(scene: bpy.types.Scene, drive: Drive, clock: Clock) -> FloatArray:
    """Return the ego vehicle's poses (N, 4, 4), those that were recorded where it was deleted."""
    ego = next(imported_objects(scene, "EGO"), None)
    return drive.world_from_ego.at(clock.times_s) if ego is None else keyed_poses(ego, clock.frames)


def card_of(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive) -> ActorCard:
    """Return the card of an actor at the frame that is shown."""
    clock = Clock.of(drive)
    ego = next(imported_objects(scene, "EGO"), None)
    apart = 0.0 if ego is None else (obj.matrix_world.translation - ego.matrix_world.translation).length
    label = class_of(obj, drive)
    return ActorCard(
        obj.name, label, role_of(scene, obj, drive), speed_at(obj, clock, scene.frame_current_final), apart,
        present_span(shown_by_keys(obj, clock.frames), clock),
        size_words(size_of(obj).tolist(), UNIT if obj.unisim.mesh else scale_of(obj)),
    )  # fmt: skip


def speed_at(obj: bpy.types.Object, clock: Clock, frame: float) -> float:
    """Return an actor's speed at a frame, that of its track; NaN where it is not there."""
    now = clock.times_s[clock.index(frame)]
    near = np.abs(clock.times_s - now) <= NEAR_S
    frames, times_s = clock.frames[near], clock.times_s[near]
    speeds = motion_of(keyed_poses(obj, frames)[:, :3, 3], times_s, there_of(obj, frames)).speed_m_s
    return float(speeds[np.flatnonzero(times_s == now)[0]])


def role_of(scene: bpy.types.Scene, obj: bpy.types.Object, drive: Drive) -> str:
    """Return what an actor is in one or two words."""
    about = obj.unisim
    copied = is_copy(scene, obj)
    is_recorded = about.uid in drive.actors and not (copied and about.look)  # as `InsertReader` has it
    return role_words(about.mesh, is_recorded, copied, bool(about.look))
