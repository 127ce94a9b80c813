"""The actors of an edited drive in an imported scene, whichever edits made them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy

from ....core.meshes.read import read_mesh
from ....core.world.drive import Actor
from ...objects.imported import collection_of, imported_objects, new_actor
from ...objects.mesh_objects import object_of
from ...objects.trajectories import remove
from .. import carriers  # noqa: F401 so that all are registered
from ..carriers.carrier import CARRIERS, Edited
from ..standing import note_scale
from .target import Target


def apply_actors(target: Target) -> Iterator[None]:
    """Remove and change objects of recorded actors, and make those of new ones, an actor at a time."""
    scene, recorded, edited = target.scene, target.recorded, target.edited
    own = {obj.unisim.uid: obj for obj in imported_objects(scene, "ACTOR") if obj.name == obj.unisim.home}
    for uid, actor in recorded.actors.items():
        now = edited.actors.get(uid)
        if now is None:
            remove(own[uid])
        elif now is not actor:
            _apply(target, own[uid], now, actor.appearance.actor)
            note_scale(own[uid], _risen(now, actor))
            yield
    for uid, actor in edited.actors.items():
        if uid not in recorded.actors and not actor.is_ego_body:
            mesh = actor.appearance.mesh
            obj = object_of(uid, read_mesh(Path(mesh)), actor.label) if mesh else new_actor(uid, actor)
            collection_of(scene, "ACTOR").objects.link(obj)
            _apply(target, obj, actor, None if mesh else actor.appearance.actor if not actor.appearance.scene else "")
            source = None if mesh or actor.appearance.scene else recorded.actors.get(actor.appearance.actor)
            note_scale(obj, _risen(actor, source) if source is not None else 0.0)
            yield


def _risen(now: Actor, before: Actor) -> float:
    """Return how much higher an actor stands than one was recorded, in metres along its own axis, but for
    another appearance."""
    time_s = before.world_from_actor.times_s[0]
    pose, recorded = now.world_from_actor.at(time_s), before.world_from_actor.at(time_s)
    higher = float((pose[:3, 3] - recorded[:3, 3]) @ recorded[:3, 2])
    return higher - float(now.appearance_size_m[2] - before.size_m[2]) / 2


def _apply(target: Target, obj: bpy.types.Object, actor: Actor, own_appearance: str | None) -> None:
    for carrier in CARRIERS.values():
        carrier.apply(obj, Edited(actor, target.edited, own_appearance, target.clock))
