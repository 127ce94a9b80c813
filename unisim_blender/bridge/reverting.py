"""One edit taken back: the object stands as it was imported."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core.prepare.scenario import scene_actors
from ..core.world.drive import Drive
from .animation import remove_curves
from .clock import Clock
from .edit_lines import ADDED, Line
from .importing import animate, fit_resolution, front_camera, go, import_one
from .meshes import extent_of
from .motion import displaced_along
from .refresh import refresh
from .sampling import shown_names
from .source import Source
from .standing import give_box, scaled_to
from .static_items import LABEL
from .things import box_mesh, collection_of, make, things
from .trajectories import remove, trajectory_of


def revert(scene: bpy.types.Scene, source: Source, line: Line) -> None:
    """Take an edit of a scene back; what else is edited stays.

    A removed object comes back, a copied or inserted one is deleted, a moved one gets its recorded trajectory and no
    displacement. Raises `UnisimError`.
    """
    thing = scene.objects.get(line.thing)
    if line.part in ADDED:
        delete(scene, thing)
    elif line.part == "APPEARANCE":
        set_appearance(thing, source.drive, "", "")
        refresh([thing])
    elif line.part == "SCALE":
        unscaled(thing)
        refresh([thing])
    else:
        thing = restore(scene, source, line.kind, line.uid, thing)
        if line.part == "REMOVE" and thing.unisim.look:
            set_appearance(thing, source.drive, "", "")


def restore(scene: bpy.types.Scene, source: Source, kind: str, uid: str, thing: bpy.types.Object | None) -> bpy.types.Object:
    """Put an object of the drive back to where it was imported, or into the scene again where ``thing`` is None; an
    actor keeps
    its appearance. Return the object."""
    drive = source.drive
    scale, lift_m = (1.0, 1.0, 1.0), 0.0
    if thing is not None:
        scale, lift_m = tuple(thing.scale), thing.unisim.scale_lift_m
        unmoved(thing)
    if kind == "STATIC":
        thing = _item(scene, uid, thing)
    elif kind == "EGO":
        animate(thing, drive.world_from_ego, Clock.of(drive))
    elif kind == "ACTOR" and thing is not None:
        actor = drive.actors[uid]
        go(thing, actor, drive, Clock.of(drive))
        lift(thing, (float(extent_of(thing)[2]) - float(actor.size_m[2])) / 2 if thing.unisim.look else 0.0)
        thing.unisim.scale_lift_m = 0.0
        scaled_to(thing, scale, lift_m)  # a scale is an edit of its own
    else:
        if kind in ("CAMERA", "LIDAR") and thing is None:  # hidden, it is missing for the scenario alone
            thing = next((t for t in things(scene, kind) if t.unisim.uid == uid and t.name == t.unisim.home), None)
            if thing is not None:
                unmoved(thing)
        import_one(scene, source, kind, uid)
        thing = next(t for t in things(scene, kind) if t.unisim.uid == uid and t.name == t.unisim.home)
        if kind == "CAMERA":
            scene.camera = scene.camera or thing
            fit_resolution(scene)
    show(scene, thing)
    refresh([thing])
    return thing


def unmoved(thing: bpy.types.Object) -> None:
    """Take away whatever moves, turns, scales or hides an object, but its trajectory."""
    thing.animation_data_clear()
    for constraint in list(thing.constraints):
        thing.constraints.remove(constraint)
    thing.parent_type = "OBJECT"
    thing.scale = thing.delta_scale = (1.0, 1.0, 1.0)
    thing.delta_location = thing.delta_rotation_euler = (0.0, 0.0, 0.0)
    thing.delta_rotation_quaternion = (1.0, 0.0, 0.0, 0.0)
    thing.hide_render = thing.hide_viewport = False


def unscaled(thing: bpy.types.Object) -> None:
    """Give an object the size that it was imported with."""
    remove_curves(thing, "scale", "delta_scale")
    thing.delta_scale = (1.0, 1.0, 1.0)
    scaled_to(thing, (1.0, 1.0, 1.0), 0.0)


def show(scene: bpy.types.Scene, thing: bpy.types.Object) -> None:
    """Put an object into a collection that is rendered, where it is in none."""
    layer = scene.view_layers[0]
    for collection in (collection_of(scene, thing.unisim.kind), scene.collection):
        if thing.name in shown_names(layer.layer_collection):
            break
        if thing.name not in collection.objects:
            collection.objects.link(thing)
    if thing.name in layer.objects:
        thing.hide_set(False, view_layer=layer)


def set_appearance(thing: bpy.types.Object, drive: Drive, look: str, look_scene: str) -> None:
    """Give an actor the appearance of another one, "" for its own: that one's box, on the same ground."""
    named = look or thing.unisim.uid
    actor = (scene_actors(Path(bpy.path.abspath(look_scene))) if look_scene else drive.actors)[named]
    thing.unisim.look, thing.unisim.look_scene = look, look_scene
    give_box(thing, box_mesh(actor.size_m, actor.label), float(actor.size_m[2]))


def lift(thing: bpy.types.Object, up_m: float) -> None:
    """Displace an object upwards along its own axes; that is no change that a person made."""
    if up_m == 0.0:
        return
    displaced_along(thing, (0.0, 0.0, up_m))
    if trajectory_of(thing) is not None:
        thing.unisim.rest_location = thing.location


def delete(scene: bpy.types.Scene, thing: bpy.types.Object) -> None:
    """Delete an object with its parts; an active camera makes way for the one that looks ahead."""
    was_active = scene.camera == thing
    for part in thing.children_recursive if thing.unisim.mesh else ():
        bpy.data.objects.remove(part)
    remove(thing)
    if was_active:
        scene.camera = front_camera(scene)
        fit_resolution(scene)


def _item(scene: bpy.types.Scene, uid: str, thing: bpy.types.Object | None) -> bpy.types.Object:
    """Put the box of a static item where it was marked."""
    items = scene.unisim.static_items
    told = items[uid].model if uid in items or thing is None else thing.unisim.model
    marked = json.loads(told)
    if thing is None:
        thing = make(scene, "STATIC", uid, uid, box_mesh(np.array(marked["size_m"]), LABEL))
        thing.show_wire, thing.unisim.model = True, json.dumps(marked)
    thing.parent, thing.rotation_mode = None, "QUATERNION"
    thing.location, thing.rotation_quaternion, _ = Matrix(marked["world_from_box"]).decompose()
    return thing
