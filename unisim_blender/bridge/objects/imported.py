"""Objects of a drive in a Blender scene: found, made, copied, named, put into their collections; the recorded drive that
the scene was imported from."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping

import bpy
import numpy as np
from mathutils import Matrix

from ...core.actor_images.names import full_name
from ...core.errors import UnisimError
from ...core.geometry import FloatArray
from ...core.world.drive import Actor, Drive
from ...editing.actors.table import is_plain
from ...editing.layout.shapes import box_shape, class_colour
from ...editing.motion.kinematics import label_of
from ...editing.sampled.source import DriveSource, NotImported, open_source

COLLECTIONS = {
    "EGO": "Ego", "CAMERA": "Sensors", "LIDAR": "Sensors", "ACTOR": "Actors", "STATIC": "Static items",
    "POINTS": "LiDAR points", "TRACK": "Boxes",
    "TRAJECTORY": "Trajectories", "BODY": "Ego", "STREET_LAMP": "Street lamps",
}  # fmt: skip
ROOT_COLLECTION = "UniSim"
KINDS_OF_DRIVE = ("EGO", "CAMERA", "LIDAR", "ACTOR", "STATIC", "BODY")
"""Kinds of objects that a scenario is read from."""
STATIC_LABEL = "Static item"
BOX_PREFIX = "UniSim box "
"""Prefix of the names of boxes' meshes, which all variants share."""


def imported_objects(scene: bpy.types.Scene, *kinds: str) -> Iterator[bpy.types.Object]:
    """The scene's objects of some kinds, by name."""
    for obj in sorted(scene.objects, key=lambda o: o.name):
        if obj.unisim.kind in kinds:
            yield obj


def rides_on_ego(obj: bpy.types.Object) -> bool:
    """Return whether an object is the ego vehicle or rides on it: by its parents, or by a constraint to
    what rides there."""
    for above in with_parents(obj):
        targets = [getattr(constraint, "target", None) for constraint in above.constraints if not constraint.mute]
        if above.unisim.kind == "EGO" or any(ego_above(target) for target in targets if target is not None):
            return True
    return False


def sees_body(obj: bpy.types.Object) -> bool:
    """Return whether what looks through an object sees the ego vehicle's body: all but sensors on the vehicle, unless
    its property says otherwise."""
    if obj.unisim.kind not in ("CAMERA", "LIDAR"):
        return True
    setting = obj.unisim.sees_ego_body
    return setting == "ALWAYS" if setting != "AUTO" else not rides_on_ego(obj)


def with_parents(obj: bpy.types.Object) -> Iterator[bpy.types.Object]:
    """Yield an object, its parent, the parent's parent, and so on."""
    while obj is not None:
        yield obj
        obj = obj.parent


def ego_above(obj: bpy.types.Object) -> bpy.types.Object | None:
    """Return the ego vehicle that an object is, or is parented to; None where there is none."""
    return next((above for above in with_parents(obj) if above.unisim.kind == "EGO"), None)


def has_drive(scene: bpy.types.Scene) -> bool:
    """Whether a drive was imported into a scene: one made by New Scene > Copy Settings has the settings and no
    objects."""
    return bool(scene.unisim.log) and any(obj.unisim.kind in KINDS_OF_DRIVE for obj in scene.objects)


def skipped_sensors(scene: bpy.types.Scene) -> frozenset[str]:
    """Return the recorded sensors that were not imported into a scene."""
    return frozenset(json.loads(scene.unisim.skipped_sensors or "[]"))


def skip_sensors(scene: bpy.types.Scene, names: Collection[str]) -> None:
    """Note which recorded sensors are not imported into a scene."""
    scene.unisim.skipped_sensors = json.dumps(sorted(names)) if names else ""


def collection_of(scene: bpy.types.Scene, kind: str) -> bpy.types.Collection:
    """The collection for a kind of object, made where it is not there yet. Each scene has its own."""
    root = _child(scene.collection, ROOT_COLLECTION)
    return _child(root, COLLECTIONS[kind])


def _child(parent: bpy.types.Collection, name: str) -> bpy.types.Collection:
    for child in parent.children:
        if child.name.split(".")[0] == name:
            return child
    child = bpy.data.collections.new(name)
    parent.children.link(child)
    return child


def make(scene: bpy.types.Scene, kind: str, uid: str, name: str, data: bpy.types.ID | None) -> bpy.types.Object:
    """The object of that kind and id: the one that an earlier import made, with new data, or a new one."""
    obj = as_imported(scene, kind, uid)
    if obj is not None and not obj.unisim.look:
        old = obj.data
        if old is not data and type(old) is type(data):
            obj.data = data
            if old is not None and old.users == 0:
                bpy.data.batch_remove([old])
        return obj
    obj = bpy.data.objects.new(name, data)
    collection_of(scene, kind).objects.link(obj)
    obj.unisim.kind, obj.unisim.uid, obj.unisim.home = kind, uid, obj.name
    obj.unisim.rest_scale = obj.scale
    return obj


def as_imported(scene: bpy.types.Scene, kind: str, uid: str) -> bpy.types.Object | None:
    """Return the object that has the name which the import gave it, by id; None where there is none."""
    objects = imported_objects(scene, kind)
    return next((obj for obj in objects if obj.unisim.uid == uid and obj.name == obj.unisim.home), None)


def original_of(scene: bpy.types.Scene, kind: str, uid: str) -> bpy.types.Object | None:
    """Return the object that stands for what was imported with an id: the one that has the name which the import
    gave it, else, where that was renamed, the first by name. None where all were deleted."""
    return originals(scene, kind).get(uid)


def originals(scene: bpy.types.Scene, kind: str) -> dict[str, bpy.types.Object]:
    """Return the objects of a kind that stand for what was imported, as `original_of`, by id."""
    objects: dict[str, bpy.types.Object] = {}
    for obj in imported_objects(scene, kind):
        if obj.unisim.uid and (obj.unisim.uid not in objects or obj.name == obj.unisim.home):
            objects[obj.unisim.uid] = obj
    return objects


def title_of(obj: bpy.types.Object) -> str:
    """Return what a scenario calls an object that has no id of the log's: what `entitle` said, as long as the object keeps
    the name that it had then, else its name."""
    about = obj.unisim
    return about.called if about.called and about.called_as == obj.name else obj.name


def entitle(obj: bpy.types.Object, title: str) -> None:
    """Let a scenario call an object ``title``, also where its name was taken in the file and Blender gave it another."""
    obj.unisim.called, obj.unisim.called_as = title, obj.name


def look_scene_of(obj: bpy.types.Object) -> str:
    """Return the folder of the other trained scene that an object's appearance is of; "" where it is of the drive."""
    return str(bpy.path.abspath(obj.unisim.look_scene)) if obj.unisim.look_scene else ""


def class_of(obj: bpy.types.Object, drive: Drive) -> str:
    """Return the class of an actor or of the ego vehicle."""
    about = obj.unisim
    return label_of(about.kind, about.look or about.uid, look_scene_of(obj), about.label, drive)


def is_copy(scene: bpy.types.Scene, obj: bpy.types.Object) -> bool:
    """Return whether an object is a copy of another one that is there."""
    return bool(obj.unisim.uid) and original_of(scene, obj.unisim.kind, obj.unisim.uid) != obj


def new_actor(name: str, actor: Actor) -> bpy.types.Object:
    """A new object for an actor that was not imported, with the box of that actor's appearance; in
    no collection yet."""
    obj = bpy.data.objects.new(name, box_mesh(actor.appearance_size_m, actor.label))
    obj.rotation_mode, obj.show_wire = "QUATERNION", True
    obj.unisim.kind, obj.unisim.uid = "ACTOR", actor.appearance.actor
    return obj


def add_actor(
    scene: bpy.types.Scene, name: str, actor: Actor, look: str = "", look_scene: str = ""
) -> bpy.types.Object:
    """Return the same, in a scene, with the appearance of the actor ``look`` of the trained scene in a folder."""
    obj = new_actor(name, actor)
    collection_of(scene, "ACTOR").objects.link(obj)
    obj.unisim.look, obj.unisim.look_scene = look, look_scene
    return obj


def stand_at(obj: bpy.types.Object, pose: FloatArray) -> None:
    """Put an object at a pose (4, 4) in its parent's axes."""
    obj.location, obj.rotation_quaternion, _ = Matrix(np.asarray(pose, float).tolist()).decompose()


def box_mesh(size_m: FloatArray, label: str) -> bpy.types.Mesh:
    """A box of that size (3,) about the origin, with an arrow on its roof that points forward; one mesh for all
    alike."""
    name = BOX_PREFIX + " ".join(f"{s:.3f}" for s in size_m) + f" {label}"
    existing = bpy.data.meshes.get(name)
    if existing is not None:
        return existing
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(*box_shape(np.asarray(size_m, float).tolist()))
    mesh.materials.append(class_material(label))
    mesh.update()
    return mesh


def class_material(label: str) -> bpy.types.Material:
    """A class's material: its colour, see-through in the view."""
    name = f"UniSim {label}"
    material = bpy.data.materials.get(name)
    if material is None:
        material = bpy.data.materials.new(name)
        material.diffuse_color = (*class_colour(label), 0.25)
    return material


def source_of(scene: bpy.types.Scene) -> DriveSource:
    """The source of a Blender scene. Raises `NotImported` where nothing was imported into it."""
    about = scene.unisim
    if not has_drive(scene):
        raise NotImported(f'scene "{scene.name}": no drive was imported into it: File > Import')
    return open_source(bpy.path.abspath(about.log), bpy.path.abspath(about.scene) if about.scene else "")


def drive_of(scene: bpy.types.Scene) -> Drive | None:
    """Return the recorded drive of a scene, for what is drawn; None where there is none, or it cannot be read."""
    try:
        return source_of(scene).drive
    except (UnisimError, OSError):
        return None


def copy_of(context: bpy.types.Context, source: bpy.types.Object) -> bpy.types.Object:
    """A copy in the same collections, with an action of its own and the same mesh."""
    copy = source.copy()
    copy_action(source, copy)
    for collection in source.users_collection:
        collection.objects.link(copy)
    if source.unisim.mesh:
        _copy_parts(context, source, copy)
    return copy


def copy_action(source: bpy.types.Object, copy: bpy.types.Object) -> None:
    """Give a copy of an object a copy of that one's action."""
    if copy.animation_data is None or copy.animation_data.action is None:
        return
    slot = getattr(source.animation_data, "action_slot", None)
    copy.animation_data.action = source.animation_data.action.copy()
    if slot is not None:
        copy.animation_data.action_slot = copy.animation_data.action.slots[slot.identifier]


def _copy_parts(context: bpy.types.Context, source: bpy.types.Object, copy: bpy.types.Object) -> None:
    """Give a copy its own copies of what is parented to its source: that is part of it."""
    for child in source.children:
        part = copy_of(context, child)
        part.parent = copy
        part.matrix_parent_inverse = child.matrix_parent_inverse  # setting the parent forgets it
        _copy_parts(context, child, part)


def mark_static(scene: bpy.types.Scene, pose: FloatArray, size_m: FloatArray, uid: str = "") -> bpy.types.Object:
    """A new static item: what stands in the box of edges (3,) at ``pose`` (4, 4)."""
    number = 1
    while not uid:
        uid, number = f"item-{number}", number + 1
        uid = "" if uid in scene.unisim.static_items else uid
    obj = make(scene, "STATIC", uid, uid, box_mesh(size_m, STATIC_LABEL))
    obj.rotation_mode = "QUATERNION"
    obj.show_wire = True
    stand_at(obj, pose)
    obj.unisim.model = json.dumps({"world_from_box": pose.tolist(), "size_m": np.asarray(size_m, float).tolist()})
    item = scene.unisim.static_items.add()
    item.name, item.model = uid, obj.unisim.model
    return obj


def forget_static(scene: bpy.types.Scene, uid: str) -> None:
    """Take the mark off an item: its boxes go, and what stands in them stays where it is."""
    for obj in [obj for obj in scene.objects if obj.unisim.kind == "STATIC" and obj.unisim.uid == uid]:
        bpy.data.objects.remove(obj)
    index = scene.unisim.static_items.find(uid)
    if index >= 0:
        scene.unisim.static_items.remove(index)


def apply_words(scene: bpy.types.Scene, plain: Mapping[str, str], words: Mapping[str, str]) -> dict[str, str]:
    """Add the words for their colours to the names of actors that still have the name "class number" from the import.

    Names that people gave, and those of files from earlier versions, stay. Return the new names by the old ones.
    """
    by_uid: dict[str, list[bpy.types.Object]] = {}
    for obj in imported_objects(scene, "ACTOR"):
        if words.get(obj.unisim.uid) and obj.unisim.uid in plain:
            by_uid.setdefault(obj.unisim.uid, []).append(obj)
    renamed = {}
    for uid, standing in by_uid.items():
        own = next((obj for obj in standing if obj.name == obj.unisim.home), None)
        if own is None or not is_plain(own.name, plain[uid]):
            continue
        before = own.name
        own.name = full_name(plain[uid], words[uid])
        for obj in standing:
            if obj.unisim.home == before:
                obj.unisim.home = own.name
        renamed[before] = own.name
    return renamed
