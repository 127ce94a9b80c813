"""Edits muted: the object stands as it was imported, and the edit waits in the file until it is unmuted.

A scenario is the difference between the drive and what stands there. A muted edit is therefore none of the scene's
state: the
object with the edit is kept outside all scenes ("parked"), and one as imported stands in its place. A muted copy is
parked and
nothing stands in its place. An appearance is kept by name.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy

from .copies import copy_action
from .edit_lines import ADDED, Line
from .importing import fit_resolution, front_camera
from .meshes import extent_of
from .refresh import refresh
from .reverting import delete, lift, restore, set_appearance, unscaled
from .source import Source
from .standing import scaled_to
from .things import collection_of, original_of
from .trajectories import remove, trajectory_of


def mute(scene: bpy.types.Scene, source: Source, line: Line) -> None:
    """Keep an edit of a scene without letting it count. Raises `UnisimError`."""
    thing = scene.objects.get(line.thing)
    item = scene.unisim_edits.muted.add()
    note(item, line)
    if line.part in ADDED:
        _park_copy(scene, item, thing)
        return
    if line.part == "APPEARANCE":
        item.look, item.look_scene = thing.unisim.look, thing.unisim.look_scene
        set_appearance(thing, source.drive, "", "")
        refresh([thing])
        return
    if line.part == "SCALE":
        item.scale, item.scale_lift_m = thing.scale, thing.unisim.scale_lift_m
        unscaled(thing)
        refresh([thing])
        return
    if thing is not None:
        item.parked = parked_copy(thing, f"{thing.name} muted")
        note_collection(scene, item, thing)
    restore(scene, source, line.kind, line.uid, thing)


def unmute(scene: bpy.types.Scene, source: Source, number: int, rivals: Iterable[Line] = ()) -> None:
    """Let a muted edit count again. ``rivals`` are edits that cannot stand beside it (see `rivals_of`): they are
    muted instead."""
    for rival in rivals:
        mute(scene, source, rival)
    item = scene.unisim_edits.muted[number]
    parked, kind, uid, part = item.parked, item.kind, item.uid, item.part
    scale, lift_m = tuple(item.scale), item.scale_lift_m
    look, look_scene, collection = item.look, item.look_scene, scene.collection if item.at_root else item.collection
    scene.unisim_edits.muted.remove(number)
    now = original_of(scene, kind, uid)
    if part in ADDED:
        for one in (parked, *(parked.children_recursive if parked.unisim.mesh else ())):
            (collection or collection_of(scene, kind)).objects.link(one)
            one.use_fake_user = False
        refresh([parked])
    elif part == "APPEARANCE":
        set_appearance(now, source.drive, look, look_scene)
        refresh([now])
    elif part == "SCALE":
        assert now is not None  # a removal is a rival, and muted by now
        scaled_to(now, scale, lift_m)
        refresh([now])
    elif parked is None:
        delete(scene, now)
    else:
        _take_place(scene, now, parked, collection, part == "REMOVE")


def rivals_of(line: Line, lines: Iterable[Line]) -> list[Line]:
    """Return the edits that count and cannot stand beside a muted one: an actor has one trajectory, one appearance,
    or is gone."""
    if line.part in ADDED:
        return []
    own = [
        one
        for one in lines
        if one.muted < 0 and one.part not in (*ADDED, "PROBLEM") and (one.kind, one.uid) == (line.kind, line.uid)
    ]
    alone = ("APPEARANCE", "SCALE")
    apart = set(alone) if line.part != "REMOVE" else set()
    if line.part in alone:
        return [one for one in own if one.part in (line.part, "REMOVE")]
    return [one for one in own if one.part not in apart]


def drop(scene: bpy.types.Scene, number: int) -> None:
    """Delete a muted edit: what is shown stays as it is."""
    parked = scene.unisim_edits.muted[number].parked
    scene.unisim_edits.muted.remove(number)
    if parked is not None:
        discard(parked)


def discard(parked: bpy.types.Object) -> None:
    """Delete an object that is in no scene, with its parts and its trajectory."""
    for part in parked.children_recursive if parked.unisim.mesh else ():
        bpy.data.objects.remove(part)
    remove(parked)


def note(item: Any, line: Line) -> None:
    """Write the line of an edit into a muted edit."""
    item.name, item.kind, item.uid, item.part, item.what = line.who, line.kind, line.uid, line.part, line.what
    item.thing, item.start_s, item.end_s = line.thing, line.start_s, line.end_s
    item.first, item.last = line.frames[0], line.frames[-1]


def note_collection(scene: bpy.types.Scene, item: Any, thing: bpy.types.Object) -> None:
    """Note which collection an object is in. Blender keeps no pointer to a scene's own one."""
    collection = next(iter(thing.users_collection), None)
    item.at_root = collection == scene.collection
    item.collection = None if item.at_root else collection


def parked_copy(thing: bpy.types.Object, name: str) -> bpy.types.Object:
    """Return a copy of an object that is in no scene, with keys and a trajectory of its own."""
    copy = thing.copy()
    copy.name = name
    copy_action(thing, copy)
    above = trajectory_of(thing)
    if above is not None:
        inverse = thing.matrix_parent_inverse.copy()
        copy.parent = above.copy()
        copy.parent.name = f"{name} trajectory"
        copy.matrix_parent_inverse = inverse
        copy_action(above, copy.parent)
        copy.parent.use_fake_user = True  # being a parent keeps nothing in the file
    if thing.type == "CAMERA":
        copy.data = thing.data.copy()
    return copy


def _park_copy(scene: bpy.types.Scene, item: Any, thing: bpy.types.Object) -> None:
    """Take an object with its parts out of all collections; it stays in the file."""
    item.parked = thing
    note_collection(scene, item, thing)
    if scene.camera == thing:
        scene.camera = None
        _unlink(thing)
        scene.camera = front_camera(scene)
        fit_resolution(scene)
    for one in (thing, *(thing.children_recursive if thing.unisim.mesh else ())):
        _unlink(one)
        one.use_fake_user = one != thing  # a parent does not keep its parts in the file
    refresh([])


def _unlink(thing: bpy.types.Object) -> None:
    for collection in list(thing.users_collection):
        collection.objects.unlink(thing)


def _take_place(
    scene: bpy.types.Scene,
    now: bpy.types.Object | None,
    parked: bpy.types.Object,
    collection: bpy.types.Collection | None,
    hidden: bool,
) -> None:
    """Let a parked object stand where ``now`` stands, under its name; what refers to that one refers to it.

    ``collection`` is the one that it was in; ``hidden`` says that it is to be in no other, for that one may be what
    hides it.
    """
    above, layer = trajectory_of(parked), scene.view_layers[0]
    if above is not None:  # its own was in no scene
        above.use_fake_user = False
        collection_of(scene, "TRAJECTORY").objects.link(above)
    if now is None:
        (collection or collection_of(scene, parked.unisim.kind)).objects.link(parked)
        parked.name = parked.unisim.home or parked.name
        refresh([parked])
        return
    name, home = now.name, now.unisim.home
    chosen, active = name in layer.objects and now.select_get(view_layer=layer), layer.objects.active == now
    if not hidden:
        _keep_appearance(now, parked)
    now.user_remap(parked)
    remove(now)
    parked.name, parked.unisim.home = name, home
    if above is not None:
        above.name = f"{name} trajectory"
    if hidden and collection is not None:
        _unlink(parked)
        collection.objects.link(parked)
    layer.update()
    if parked.name in layer.objects and chosen:
        parked.select_set(True, view_layer=layer)
    if active:
        layer.objects.active = parked
    refresh([parked])


def _keep_appearance(now: bpy.types.Object, parked: bpy.types.Object) -> None:
    """An appearance and a scale are edits of their own: a parked actor gets those that the actor has now."""
    if now.unisim.kind == "ACTOR":
        scaled_to(parked, now.scale, now.unisim.scale_lift_m)
    if now.unisim.kind != "ACTOR" or (now.unisim.look, now.unisim.look_scene) == (parked.unisim.look, parked.unisim.look_scene):
        return
    rise = (float(extent_of(now)[2]) - float(extent_of(parked)[2])) / 2
    parked.unisim.look, parked.unisim.look_scene, parked.data = now.unisim.look, now.unisim.look_scene, now.data
    lift(parked, rise)
