"""What became of the recorded actors, and which are new: removals, moves, other looks and sizes, copies, insertions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import BoolArray, FloatArray
from ...core.prepare.scenario import scene_actors
from ...core.scenario.edit import Edit
from ...core.scenario.edits import Duplicate, Insert, InsertMesh, Move, Remove, Scale, Swap
from ...core.world.drive import Actor, Drive
from ..sampled.clock import Clock
from ..sampled.poses import SAME_M, same, same_turn
from ..sampled.scaling import UNIT, refusal, scale_text
from ..sampled.scene import Sampled
from ..sampled.scene import SampledObject as Thing
from .trajectories import present, vector, way

Relative = Callable[[str], str]
"""A trained scene's folder as the scenario names it."""


def actor_edits(sampled: Sampled, drive: Drive, taken: set[str], relative: Relative) -> Iterator[Edit]:
    """The edits that make the sampled actors of the recorded ones. Ids of new ones go into ``taken``."""
    clock = sampled.clock
    by_uid: dict[str, list[Thing]] = {}
    for thing in sampled.of("ACTOR"):
        if fault := refusal(thing.name, thing.scaling):
            raise ScenarioError(fault)
        by_uid.setdefault(thing.uid, []).append(thing)
    for uid, actor in sorted(drive.actors.items()):
        standing = by_uid.pop(uid, [])
        own = original(standing, actor, clock)
        # copies are told beside the recorded actor: they come before what became of that
        for thing in standing:
            if thing is not own and thing.there.any():
                yield from _scaled(_copy(thing, actor, drive, clock, taken, relative), thing)
        if own is None or not own.there.any():
            if recorded_there(actor, drive, clock).any():
                yield Remove(uid)
        else:
            yield from _changes(own, actor, drive, clock, relative)
    for strangers in by_uid.values():
        for thing in strangers:
            if thing.there.any():
                new = _mesh(thing, clock, taken, relative) if thing.mesh else _inserted(thing, clock, taken, relative)
                yield from _scaled(new, thing)


def refuse_scale(thing: Thing) -> None:
    """Raise `ScenarioError` where a static item's box is drawn in another size than it was marked in."""
    if thing.scaling.fault or thing.scaling.factors != UNIT:
        raise ScenarioError(
            f'object "{thing.name}": is scaled by {scale_text(thing.scaling.factors)}, which a static item cannot be: clear its '
            "scale (Alt-S), or that of its parent"
        )


def _scaled(new: Duplicate | Insert | InsertMesh, thing: Thing) -> Iterator[Edit]:
    """The edit that adds an actor, and the one that scales it where it is drawn larger or smaller."""
    yield new
    if thing.scaling.factors != UNIT:
        yield Scale(new.id, thing.scaling.factors)


def original(standing: list[Thing], actor: Actor, clock: Clock) -> Thing | None:
    """Which of the objects with one actor's id is the actor itself: the one with the name that the import gave it, else one that
    goes where the actor was recorded, else the first. Told here and not by a handler, so that undo stays Blender's."""
    recorded = recorded_poses(actor, clock)
    for thing in standing:
        if thing.is_original:
            return thing
    for thing in standing:
        if same(thing.poses, recorded).all():
            return thing
    return standing[0] if standing else None


def recorded_poses(actor: Actor, clock: Clock) -> FloatArray:
    """Poses (N, 4, 4) of an actor as the import has them."""
    way = actor.world_from_actor
    return way.at(clock.times_s if actor.is_moving else np.full(len(clock.times_s), way.times_s[0]))


def recorded_there(actor: Actor, drive: Drive, clock: Clock) -> BoolArray:
    """Whether an actor is there (N,) as the import has it."""
    start, end = drive.window(actor)
    return np.asarray((clock.times_s >= start) & (clock.times_s <= end))


def _changes(thing: Thing, actor: Actor, drive: Drive, clock: Clock, relative: Relative) -> Iterator[Edit]:
    """What became of one recorded actor."""
    poses, there = recorded_poses(actor, clock), recorded_there(actor, drive, clock)
    if thing.look:
        yield Swap(actor.uid, thing.look, relative(thing.look_scene) if thing.look_scene else None)
        poses[:, :3, 3] += (look_size_m(thing, drive)[2] - actor.size_m[2]) / 2 * poses[:, :3, 2]
    changed = bool((thing.there != there).any())
    if changed or not same(thing.poses, poses)[there].all():
        yield Move(actor.uid, **_way(thing, clock, actor), present=present(clock, thing.there) if changed else None)
    if thing.scaling.factors != UNIT:
        yield Scale(actor.uid, thing.scaling.factors)


def _copy(thing: Thing, actor: Actor, drive: Drive, clock: Clock, taken: set[str], relative: Relative) -> Duplicate | Insert:
    """Return the edit for a copy of a recorded actor; one that is displaced alike at all frames, in the world's axes or its own,
    keeps the actor's own trajectory between frames too."""
    if thing.look:
        return _inserted(thing, clock, taken, relative)
    uid, base, there = new_id(thing, taken), recorded_poses(actor, clock), recorded_there(actor, drive, clock)
    changed = bool((thing.there != there).any())
    at = thing.there & there
    apart = (thing.poses - base)[at, :3, 3]
    if not changed and same_turn(thing.poses, base)[at].all():
        if (np.ptp(apart, axis=0) <= 2 * SAME_M).all():
            return Duplicate(actor.uid, uid, world_offset_m=vector(apart.mean(0)))
        beside = np.einsum("nji,nj->ni", base[at, :3, :3], apart)
        if (np.ptp(beside, axis=0) <= 2 * SAME_M).all():
            return Duplicate(actor.uid, uid, offset_m=vector(beside.mean(0)))
    return Duplicate(actor.uid, uid, **_way(thing, clock, actor), present=present(clock, thing.there) if changed else None)


def _inserted(thing: Thing, clock: Clock, taken: set[str], relative: Relative) -> Insert:
    scene = relative(thing.look_scene) if thing.look_scene else None
    uid = new_id(thing, taken)
    return Insert(thing.look or thing.uid, uid, scene, **_way(thing, clock), present=present(clock, thing.there))


def _mesh(thing: Thing, clock: Clock, taken: set[str], relative: Relative) -> InsertMesh:
    uid = new_id(thing, taken)
    return InsertMesh(relative(thing.mesh), uid, thing.label or None, **_way(thing, clock), present=present(clock, thing.there))


def _way(thing: Thing, clock: Clock, source: Actor | None = None) -> dict[str, Any]:
    recorded = source.world_from_actor if source is not None and source.is_moving and not thing.look else None
    return dict(way(clock, thing.poses, thing.there, recorded))


def look_size_m(thing: Thing, drive: Drive) -> FloatArray:
    """Return the size (3,) of the box that comes with a thing's appearance."""
    actors = scene_actors(Path(thing.look_scene)) if thing.look_scene else drive.actors
    if thing.look not in actors:
        raise ScenarioError(f'object "{thing.name}": has the look of "{thing.look}", which {thing.look_scene or "the log"} lacks')
    return actors[thing.look].size_m


def new_id(thing: Thing, taken: set[str]) -> str:
    """An id after the object's name that nothing else has; it goes into ``taken``."""
    uid, number = thing.title, 2
    while uid in taken:
        uid, number = f"{thing.title} {number}", number + 1
    taken.add(uid)
    return uid
