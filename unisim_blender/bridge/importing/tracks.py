"""Boxes that are corrected before they become the actors of the log: put into a scene, read from it, and saved."""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import replace

import bpy
import numpy as np

from ...core.errors import UnisimError
from ...core.geometry import FloatArray, Trajectory
from ...core.tracks.box_file import Track, track_from_json, track_to_json, unused_uid
from ...core.world.drive import Actor, Appearance, Drive
from ...editing.sampled.clock import Clock
from ...editing.sampled.scene import rigid
from ...editing.sampled.source import DriveSource
from ..objects.animation import keys_of
from ..objects.imported import as_imported, box_mesh, collection_of, imported_objects, originals
from ..objects.trajectories import keyed_poses, local_poses, remove, trajectory_of
from .drive import go, import_object, single_key

SAME_M = 1e-3
"""Distance up to which a box stands where the recorded one does."""


def tracks_in(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the boxes of a scene that are corrected, by name."""
    return list(imported_objects(scene, "TRACK"))


def put_track(scene: bpy.types.Scene, track: Track, drive: Drive) -> bpy.types.Object:
    """Return the new box of a track."""
    actor = track.actor
    obj = bpy.data.objects.new(f"{actor.label} {actor.uid[:24]}", box_mesh(actor.size_m, actor.label))
    collection_of(scene, "TRACK").objects.link(obj)
    obj.unisim.kind, obj.unisim.uid = "TRACK", actor.uid
    obj.rotation_mode, obj.show_wire, obj.hide_render = "QUATERNION", True, True
    set_track(obj, track, drive)
    return obj


def set_track(obj: bpy.types.Object, track: Track, drive: Drive) -> None:
    """Give a box all that a track is, in place of what it was."""
    actor, about, before = track.actor, obj.unisim_track, obj.data
    path = actor.world_from_actor
    about.certainty, about.size_m = track.certainty, actor.size_m.tolist()
    about.drawn = json.dumps([[time, path.at(time).ravel().tolist()] for time in track.drawn_s])
    about.track = json.dumps(track_to_json(replace(track, actor=replace(actor, world_from_actor=single_key(path)))))
    obj.data, obj.scale = box_mesh(actor.size_m, actor.label), (1.0, 1.0, 1.0)
    if before is not obj.data and before.users == 0:
        bpy.data.meshes.remove(before)
    go(obj, actor, drive, Clock.of(drive))
    if trajectory_of(obj) is None:  # its place is no displacement
        obj.unisim.rest_location, obj.unisim.rest_rotation = obj.location, obj.rotation_quaternion


def size_now(obj: bpy.types.Object) -> FloatArray:
    """Return the size (3,) of a box, which Blender's tools may have changed."""
    return np.array(obj.unisim_track.size_m) * np.abs(np.array(obj.scale))


def pose_now(obj: bpy.types.Object) -> FloatArray:
    """Return the pose (4, 4) of a box in the world at the frame that is shown."""
    return rigid(np.array(obj.matrix_world, float))


def path_of(obj: bpy.types.Object, clock: Clock, displaced: bool = True) -> Trajectory:
    """Return the trajectory of a box, with its displacement or without; of one key where it stands."""
    above = trajectory_of(obj)
    keys = None if above is None else keys_of(above)
    if keys is None or len(keys[0]) < 2:
        return Trajectory.from_poses(clock.times_s[:1], rigid(keyed_poses(obj, clock.frames[:1].tolist())))
    frames = keys[0].tolist()
    poses = keyed_poses(above, frames)
    return Trajectory.from_poses(clock.time_s(keys[0]), poses @ local_poses(obj, frames) if displaced else poses)


def track_of(obj: bpy.types.Object, clock: Clock, displaced: bool = True) -> Track:
    """Return the track of a box, with its displacement or without."""
    about, path, uid = obj.unisim_track, path_of(obj, clock, displaced), obj.unisim.uid
    track = track_from_json(json.loads(about.track), obj.name)
    actor = replace(
        track.actor,
        uid=uid,
        size_m=size_now(obj),
        world_from_actor=path,
        is_moving=len(path.times_s) > 1,
        appearance=Appearance(uid),
    )
    drawn = tuple(time for time, _ in drawn_of(obj))
    return replace(track, actor=actor, certainty=min(1.0, max(0.0, round(about.certainty, 6))), drawn_s=drawn)


def drawn_of(obj: bpy.types.Object) -> list[tuple[float, list[float]]]:
    """Return the keys that a person set: times, seconds, and poses of 16 numbers, in order of time."""
    return sorted((float(time), list(pose)) for time, pose in json.loads(obj.unisim_track.drawn or "[]"))


def new_uid(scene: bpy.types.Scene, drive: Drive, like: str = "box") -> str:
    """Return an id that no actor and no box has."""
    return unused_uid(like, {obj.unisim.uid for obj in tracks_in(scene)} | set(drive.actors))


def saved_tracks(boxes: Iterable[bpy.types.Object], source: DriveSource) -> list[Track]:
    """Return the tracks of boxes; those that stand as they were recorded are the recorded ones to the last bit. Raises
    `UnisimError` where two have one id, which a copy made by Blender's tools gets."""
    clock, tracks = Clock.of(source.drive), dict[str, Track]()
    for obj in boxes:
        track = track_of(obj, clock)
        uid = track.actor.uid
        if uid in tracks:
            obj.unisim.uid = uid = new_uid(obj.users_scene[0], source.drive)
            track = track_of(obj, clock)
        recorded = source.drive.actors.get(uid)
        if recorded is not None and _same(track.actor, recorded):
            track = replace(track, actor=recorded)
        tracks[uid] = track
    return list(tracks.values())


def _same(actor: Actor, recorded: Actor) -> bool:
    members = "label", "is_moving", "start_s", "end_s"
    if any(getattr(actor, name) != getattr(recorded, name) for name in members):
        return False
    times = recorded.world_from_actor.times_s if recorded.is_moving else actor.world_from_actor.times_s
    apart = actor.world_from_actor.at(times) - recorded.world_from_actor.at(times)
    return max(np.abs(actor.size_m - recorded.size_m).max(), np.abs(apart).max()) < SAME_M


def hide_actors(scene: bpy.types.Scene, hide: bool) -> None:
    """Hide the actors of a scene while boxes are corrected in their places, or show them again."""
    layer = bpy.context.view_layer
    for obj in imported_objects(scene, "ACTOR"):
        if obj.name in layer.objects:
            obj.hide_set(hide)


def take_tracks(scene: bpy.types.Scene) -> None:
    """Remove all boxes that are corrected."""
    for obj in tracks_in(scene):
        remove(obj)
    hide_actors(scene, False)


def exchange_actors(scene: bpy.types.Scene, before: Drive, source: DriveSource) -> None:
    """Put the actors of ``source``, the same log with other boxes, into a scene in place of those of ``before``. Raises
    `UnisimError` where something in the scene is a copy of one that is gone."""
    gone = set(before.actors) - set(source.drive.actors)
    own = originals(scene, "ACTOR")
    for obj in imported_objects(scene, "ACTOR"):
        if obj.unisim.uid in gone and own.get(obj.unisim.uid) is not obj:
            raise UnisimError(f"{obj.name}: is a copy of an actor that the boxes do not have; delete it first")
    for uid in before.actors:
        if (obj := as_imported(scene, "ACTOR", uid)) is not None:
            remove(obj)
    scene.unisim.log = str(source.log_path)
    for uid in sorted(source.drive.actors):
        import_object(scene, source, "ACTOR", uid)


def displaced(obj: bpy.types.Object) -> bool:
    """Whether Blender's tools moved, turned or scaled a box since it was placed."""
    moved = (
        np.array(obj.location) - obj.unisim.rest_location,
        np.array(obj.rotation_quaternion) - obj.unisim.rest_rotation,
    )
    return any(float(np.abs(part).max()) > 1e-5 for part in (*moved, np.array(obj.scale) - 1))
