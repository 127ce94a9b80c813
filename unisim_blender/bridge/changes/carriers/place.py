"""Edits of where an object of the drive is, and of whether it is there. A muted one is kept outside all scenes, and an
object as imported stands in its place."""

from __future__ import annotations

import json
from typing import Any

import bpy
import numpy as np

from ....editing.edits.lines import PARTS, EditLine
from ....editing.sampled.clock import Clock
from ....editing.sampled.source import DriveSource
from ...importing.drive import animate, fit_resolution, go, import_object
from ...objects.imported import STATIC_LABEL, as_imported, box_mesh, collection_of, make, stand_at
from ...objects.meshes import extent_of
from ...objects.trajectories import remove, trajectory_of
from ...sampling.stepping import shown_names
from ...window import refresh
from .appearance import lift, set_appearance
from .carrier import CARRIERS, Carrier, Edited, Muted, register
from .own_object import delete, note_collection, parked_copy, unlink
from .scale import scaled_to


@register
class PlaceCarrier(Carrier):
    """An object's keys, constraints and visibility, and its lens or beams."""

    name = "place"

    def apply(self, obj: bpy.types.Object, edited: Edited) -> None:
        go(obj, edited.actor, edited.drive, edited.clock)

    def mute(
        self, scene: bpy.types.Scene, source: DriveSource, item: Any, line: EditLine, obj: bpy.types.Object | None
    ) -> None:
        """Keep a copy of the object; one that is not there needs none."""
        if obj is not None:
            item.parked = parked_copy(obj, f"{obj.name} muted")
            note_collection(scene, item, obj)
        restore(scene, source, line.kind, line.uid, obj)

    def unmute(self, scene: bpy.types.Scene, source: DriveSource, muted: Muted, now: bpy.types.Object | None) -> None:
        """Let the object of the edit take the place of the one as imported, or delete that one."""
        if muted.parked is None:
            assert now is not None
            delete(scene, now)
        else:
            _take_place(scene, now, muted.parked, muted.collection, PARTS[muted.part].is_absence)

    def revert(self, scene: bpy.types.Scene, source: DriveSource, line: EditLine, obj: bpy.types.Object | None) -> None:
        """Put the object back to where it was imported; one that was gone has its own appearance."""
        restored = restore(scene, source, line.kind, line.uid, obj)
        if PARTS[line.part].is_absence and restored.unisim.look:
            set_appearance(restored, source.drive, "", "")


def restore(
    scene: bpy.types.Scene, source: DriveSource, kind: str, uid: str, obj: bpy.types.Object | None
) -> bpy.types.Object:
    """Put an object of the drive back to where it was imported, or into the scene again where ``obj`` is None; an actor
    keeps its appearance and scale. Return the object."""
    drive = source.drive
    scale, lift_m = (1.0, 1.0, 1.0), 0.0
    if obj is not None:
        scale, lift_m = tuple(obj.scale), obj.unisim.scale_lift_m
        unmoved(obj)
    if kind == "STATIC":
        obj = _item(scene, uid, obj)
    elif kind == "EGO":
        animate(obj, drive.world_from_ego, Clock.of(drive))
    elif kind == "ACTOR" and obj is not None:
        actor = drive.actors[uid]
        go(obj, actor, drive, Clock.of(drive))
        lift(obj, (float(extent_of(obj)[2]) - float(actor.size_m[2])) / 2 if obj.unisim.look else 0.0)
        obj.unisim.scale_lift_m = 0.0
        scaled_to(obj, scale, lift_m)  # a scale is an edit of its own
    else:
        if kind in ("CAMERA", "LIDAR") and obj is None:  # hidden, it is missing for the scenario alone
            obj = as_imported(scene, kind, uid)
            if obj is not None:
                unmoved(obj)
        import_object(scene, source, kind, uid)
        obj = as_imported(scene, kind, uid)
        if kind == "CAMERA":
            scene.camera = scene.camera or obj
            fit_resolution(scene)
    show(scene, obj)
    refresh([obj])
    return obj


def unmoved(obj: bpy.types.Object) -> None:
    """Take away whatever moves, turns, scales or hides an object, but its trajectory."""
    obj.animation_data_clear()
    for constraint in list(obj.constraints):
        obj.constraints.remove(constraint)
    obj.parent_type = "OBJECT"
    obj.scale = obj.delta_scale = (1.0, 1.0, 1.0)
    obj.delta_location = obj.delta_rotation_euler = (0.0, 0.0, 0.0)
    obj.delta_rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    obj.hide_render = obj.hide_viewport = False


def show(scene: bpy.types.Scene, obj: bpy.types.Object) -> None:
    """Put an object into a collection that is rendered, where it is in none."""
    layer = scene.view_layers[0]
    for collection in (collection_of(scene, obj.unisim.kind), scene.collection):
        if obj.name in shown_names(layer.layer_collection):
            break
        if obj.name not in collection.objects:
            collection.objects.link(obj)
    if obj.name in layer.objects:
        obj.hide_set(False, view_layer=layer)


def _item(scene: bpy.types.Scene, uid: str, obj: bpy.types.Object | None) -> bpy.types.Object:
    """Put the box of a static item where it was marked."""
    items = scene.unisim.static_items
    document = items[uid].model if uid in items or obj is None else obj.unisim.model
    marked = json.loads(document)
    if obj is None:
        obj = make(scene, "STATIC", uid, uid, box_mesh(np.array(marked["size_m"]), STATIC_LABEL))
        obj.show_wire, obj.unisim.model = True, json.dumps(marked)
    obj.parent, obj.rotation_mode = None, "QUATERNION"
    stand_at(obj, marked["world_from_box"])
    return obj


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
    name, original_name = now.name, now.unisim.home
    chosen, active = name in layer.objects and now.select_get(view_layer=layer), layer.objects.active == now
    if not hidden and now.unisim.kind == "ACTOR":
        for carrier in CARRIERS.values():
            carrier.keep(now, parked)
    now.user_remap(parked)
    remove(now)
    parked.name, parked.unisim.home = name, original_name
    if above is not None:
        above.name = f"{name} trajectory"
    if hidden and collection is not None:
        unlink(parked)
        collection.objects.link(parked)
    layer.update()
    if parked.name in layer.objects and chosen:
        parked.select_set(True, view_layer=layer)
    if active:
        layer.objects.active = parked
    refresh([parked])
