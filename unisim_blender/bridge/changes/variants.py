"""Variants: scenarios of one drive as scenes of one file. Each has objects, keys and cameras of its own.

Blender gives the objects of a copied scene other names. Their ids stay: `home` follows the name of what was imported,
and `called` keeps the name that a scenario has for the rest (see `imported.title_of`).
"""

from __future__ import annotations

import bpy

from ...core.errors import UnisimError
from ...editing.edits.variants import checked_name
from ..objects.imported import BOX_PREFIX, copy_action, entitle, has_drive, title_of
from ..objects.trajectories import trajectory_of
from ..sampling.adjacent_frames import BESIDE_SCENE
from ..sampling.edit_list import renamed
from .carriers.own_object import discard, parked_copy

COPY_TAG = "unisim_copied_from"
"""A custom property that is there while a scene is copied: the number of what is copied."""


def variants_of(scene: bpy.types.Scene) -> list[bpy.types.Scene]:
    """Return the scenes of the file that hold the drive of ``scene``, by name."""
    others = [other for other in bpy.data.scenes if other.name != BESIDE_SCENE and other.unisim.log == scene.unisim.log]
    return sorted((other for other in others if has_drive(other)), key=lambda other: other.name)


def new_variant(window: bpy.types.Window, scene: bpy.types.Scene, name: str) -> bpy.types.Scene:
    """Copy a scene with its objects, keys, cameras and muted edits under a free name, and show the copy in
    ``window``."""
    checked_name(name, bpy.data.scenes)
    before = set(bpy.data.scenes)
    sources = [*scene.objects, *scene.collection.children_recursive]
    for number, source in enumerate(sources):
        source[COPY_TAG] = number
    try:
        with bpy.context.temp_override(window=window, scene=scene):
            bpy.ops.scene.new(type="FULL_COPY")
    finally:
        for source in sources:
            del source[COPY_TAG]
    (variant,) = set(bpy.data.scenes) - before
    pairs = {}
    for copy in (*variant.objects, *variant.collection.children_recursive):
        if COPY_TAG in copy:
            pairs[sources[copy[COPY_TAG]]] = copy
            del copy[COPY_TAG]
    objects = {old: new for old, new in pairs.items() if isinstance(old, bpy.types.Object)}
    _keep_ids(objects)
    _own_data(objects)
    _copy_muted(scene, variant, pairs)
    for new in [new for new in objects.values() if new.unisim.kind == "POINTS"]:  # they follow from the rest
        bpy.data.objects.remove(new)
    variant.name = name
    window.scene = variant
    variant.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    return variant


def rename_variant(scene: bpy.types.Scene, name: str) -> None:
    """Give a variant another name. Raises `UnisimError` where it is taken."""
    before = scene.name
    if name != before:
        checked_name(name, bpy.data.scenes)
        scene.name = name
        renamed(before, scene.name)


def show_variant(window: bpy.types.Window, scene: bpy.types.Scene) -> None:
    """Show a variant in a window, at the frame that the window shows."""
    now = window.scene
    window.scene = scene
    if now.unisim.log == scene.unisim.log and scene.frame_current_final != now.frame_current_final:
        scene.frame_set(now.frame_current, subframe=now.frame_subframe)


def delete_variant(scene: bpy.types.Scene) -> bpy.types.Scene:
    """Delete a variant with all that is in no other scene, and show another one. Return that. Raises `UnisimError`."""
    others = [variant for variant in variants_of(scene) if variant != scene]
    if not others:
        raise UnisimError(f'"{scene.name}": is the only variant; revert its edits instead')
    for window in bpy.context.window_manager.windows:
        if window.scene == scene:
            show_variant(window, others[0])
    for item in scene.unisim_edits.muted:
        if item.parked is not None:
            discard(item.parked)
    elsewhere = [other for other in bpy.data.scenes if other != scene]
    shared = {block for other in elsewhere for block in (*other.objects, *other.collection.children_recursive)}
    objects = [obj for obj in scene.objects if obj not in shared]
    collections = [collection for collection in scene.collection.children_recursive if collection not in shared]
    used = {obj.animation_data.action for obj in objects if obj.animation_data is not None}
    used |= {obj.data for obj in objects}
    used.discard(None)
    bpy.data.scenes.remove(scene)
    bpy.data.batch_remove([*objects, *collections])
    bpy.data.batch_remove([block for block in used if block.users == 0])
    return others[0]


def _keep_ids(objects: dict[bpy.types.Object, bpy.types.Object]) -> None:
    """Let copies of imported objects be imported ones, and copies of the rest keep what a scenario calls them."""
    original_names = {old.unisim.home: new.name for old, new in objects.items() if old.name == old.unisim.home}
    for old, new in objects.items():
        new.unisim.home = original_names.get(old.unisim.home, new.unisim.home)
        entitle(new, title_of(old))


def _own_data(objects: dict[bpy.types.Object, bpy.types.Object]) -> None:
    """Give copies what an edit may change, and let them share boxes: Blender's preferences say which data it
    copies."""
    doubled = set()
    for old, new in objects.items():
        if new.animation_data is not None and new.animation_data.action is not None:
            if new.animation_data.action == old.animation_data.action:
                copy_action(old, new)
        if old.data is None:
            continue
        if old.type == "MESH" and old.data.name.startswith(BOX_PREFIX):
            if new.data != old.data:
                doubled.add(new.data)
                new.data = old.data
        elif new.data == old.data and old.type in ("CAMERA", "MESH"):
            new.data = old.data.copy()
    bpy.data.batch_remove([mesh for mesh in doubled if mesh.users == 0])


def _copy_muted(scene: bpy.types.Scene, variant: bpy.types.Scene, pairs: dict[bpy.types.ID, bpy.types.ID]) -> None:
    """Give a variant copies of the objects that muted edits keep."""
    for old, new in zip(scene.unisim_edits.muted, variant.unisim_edits.muted, strict=True):
        new.collection = pairs.get(old.collection)
        there = scene.objects.get(old.thing)
        if there is not None and there in pairs:
            new.thing = pairs[there].name
        if old.parked is None:
            continue
        parked = _parked(old.parked, pairs)
        if there is None:  # it is a copy that was muted: it keeps what a scenario calls it
            entitle(parked, title_of(old.parked))
            new.thing = parked.name
        elif old.parked.unisim.home == there.unisim.home:
            parked.unisim.home, parked.unisim.called_as = pairs[there].unisim.home, pairs[there].name
            parked.unisim.called = pairs[there].unisim.called
        new.parked = parked


def _parked(old: bpy.types.Object, pairs: dict[bpy.types.ID, bpy.types.ID]) -> bpy.types.Object:
    """Return a copy of an object in no scene, with its trajectory and parts; what those refer to is the variant's."""
    above = trajectory_of(old)
    shared = above is not None and above in pairs  # the trajectory of a muted copy stays in the scene
    new = old.copy() if shared else parked_copy(old, old.name)
    if shared:
        copy_action(old, new)
    _reparent(new.parent if above is not None and not shared else new, pairs)
    for child in old.children if old.unisim.mesh else ():
        part = _parked(child, pairs)
        inverse = child.matrix_parent_inverse.copy()
        part.parent = new
        part.matrix_parent_inverse, part.use_fake_user = inverse, True
    return new


def _reparent(obj: bpy.types.Object, pairs: dict[bpy.types.ID, bpy.types.ID]) -> None:
    if obj.parent in pairs:
        inverse = obj.matrix_parent_inverse.copy()
        obj.parent = pairs[obj.parent]
        obj.matrix_parent_inverse = inverse
