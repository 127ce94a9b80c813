"""Reads the edits of recorded actors and of new ones: a reader for each edit, and one that passes the objects of each
id to them.

Of recorded actors: `remove`, without an object or with one that is not rendered; `swap`, with the appearance of another
one; `move`, elsewhere or at other times than recorded; `scale`, drawn larger or smaller than imported. New ones:
`duplicate`, a copy of a recorded actor's object; `insert`, an object with an appearance that is not its source's, or of
an actor that the recording does not have; `insert_mesh`, an object that is a mesh; `row`, copies that stand in one.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...core.actor_images.names import plain_names
from ...core.errors import ScenarioError, UnisimError
from ...core.geometry import BoolArray, FloatArray, Trajectory, invert_pose
from ...core.scenario import build
from ...core.scenario.edit import Edit
from ...core.scenario.edits import Duplicate, Insert, InsertMesh, Move, Remove, Row, Scale, Swap
from ...core.scenario.edits.move import shifted
from ...core.scenario.edits.row import clear, standing
from ...core.scenario.motion.keys import Present
from ...core.scenario.motion.maneuvers import Maneuver
from ...core.scenario.motion.paths import arc_lengths_of, is_path
from ...core.scenario.motion.trajectories import merged_times, sampled_keys
from ...core.world.drive import Actor
from ..edits.lines import EditLine, joined, line_of, unmoved
from ..edits.maneuvers import PLACED, noted
from ..edits.reader import (
    ACTORS,
    NEW_ACTORS,
    ActorEditContext,
    ActorReader,
    GroupReader,
    NewActorReader,
    ReadContext,
    register,
)
from ..edits.trajectories import present, vector
from ..sampled.clock import Clock, recorded_poses
from ..sampled.scene import SAME_M, UNIT, SampledObject, differ, near, refusal, same, same_turn, scale_text
from ..texts import LOWER, Text, cased

LATER_DIGITS, OFFSET_DIGITS, AHEAD_DIGITS = 4, 5, 2
"""Of a shift's seconds and metres: Blender's float32 keys tell no more."""
SAME_LATER_S = 1e-3
ALONG = 8.0
"""By how much less than poses elsewhere those of a shift agree: between keys, Blender goes by frames and by numbers."""


class ReadEdit(NamedTuple):
    """An edit, its reader, and the object that it was read off. ``has_line``: whether it has a line of its own.
    ``maneuvers`` come after it, and are told in its place."""

    edit: Edit
    reader: ActorReader[Any] | NewActorReader[Any]
    context: ActorEditContext
    has_line: bool = True
    maneuvers: tuple[Maneuver, ...] = ()


@register
class Actors(GroupReader):
    """Reads actors, those of each id together: the recorded one and its copies, or inserted ones."""

    group = "ACTOR"
    kinds = ("ACTOR",)
    by_id = True

    def edits(self, reading: ReadContext) -> Iterator[Edit]:
        """The edits of the recorded actors by their ids, then of inserted ones and of rows."""
        rows = list(_rows(reading))
        standing = {obj.name for _, members in rows for obj in members}
        by_id = {uid: [obj for obj in objects if obj.name not in standing] for uid, objects in _by_id(reading).items()}
        for uid in sorted(reading.drive.actors):
            yield from _before_maneuvers(reading, _read_edits(reading, uid, by_id.pop(uid, [])))
        for uid, objects in by_id.items():
            yield from _before_maneuvers(reading, _read_edits(reading, uid, objects))
        yield from (row for row, _ in rows)

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        for item in read_edits(reading, uid):
            has_line = item.has_line and not item.maneuvers
            line = item.reader.line(item.edit, item.context) if has_line else None
            if line is not None:
                yield line

    def edited_ids(self, reading: ReadContext) -> set[str]:
        by_id = _by_id(reading)
        return {
            uid
            for uid in reading.drive.actors
            if any(
                isinstance(item.reader, ActorReader) and item.has_line
                for item in _read_edits(reading, uid, by_id.get(uid, []))
            )
        }


def _before_maneuvers(reading: ReadContext, items: Iterable[ReadEdit]) -> Iterator[Edit]:
    """Yield the edits; maneuvers go to ``reading``, as they come after all others of actors and of the ego vehicle."""
    for item in items:
        reading.maneuvers.extend(item.maneuvers)
        if not isinstance(item.edit, Maneuver):
            yield item.edit


def _by_id(reading: ReadContext) -> dict[str, list[SampledObject]]:
    by_id: dict[str, list[SampledObject]] = {}
    for obj in reading.sampled.of("ACTOR"):
        if fault := refusal(obj.name, obj.scaling):
            raise ScenarioError(fault)
        by_id.setdefault(obj.uid, []).append(obj)
    return by_id


def unreadable(reading: ReadContext) -> dict[str, UnisimError]:
    """Return why actors' objects cannot be read, each for itself, by the objects' names."""
    faults: dict[str, UnisimError] = {}
    for obj in reading.sampled.of("ACTOR"):
        alone = replace(reading, taken=set(reading.taken))
        context = ActorEditContext(alone, obj, reading.drive.actors.get(obj.uid))
        try:
            if fault := refusal(obj.name, obj.scaling):
                raise ScenarioError(fault)
            if obj.appearance:
                _ = context.appearance_size_m
            for _ in _read_edits(alone, obj.uid, [obj]):
                pass
        except UnisimError as fault:
            faults[obj.name] = fault
    return faults


def row_of(text: str) -> Row | None:
    """Return the row that an object notes as JSON; None where it notes none."""
    row = build(Edit, json.loads(text)) if text else None
    return row if isinstance(row, Row) else None


def _rows(reading: ReadContext) -> Iterator[tuple[Row, list[SampledObject]]]:
    """The rows whose objects stand where their edit puts them, and these. Of some frames alone there are none."""
    if len(reading.clock.frames) < len(reading.drive.time_s):
        return
    actors = list(reading.sampled.of("ACTOR"))
    others = [(obj.poses[obj.there], np.array(obj.size_m)) for obj in actors if not obj.row and obj.there.any()]
    for text in sorted({obj.row for obj in actors if obj.row}):
        row = row_of(text)
        if row is None or row.actor not in reading.drive.actors:
            continue
        source = reading.drive.actors[row.actor]
        poses = row.poses(standing(source), source.size_m, reading.drive, row.id)
        poses = poses[clear(poses, source.size_m, others)]
        named = {f"{row.id} {number}": pose for number, pose in enumerate(poses, 1)}
        members = [obj for obj in actors if obj.row == text and obj.title in named and not obj.appearance]
        members = [obj for obj in members if obj.there.all() and same(obj.poses, named[obj.title]).all()]
        if len(members) == len(named):
            others += [(obj.poses[:1], source.size_m) for obj in members]
            reading.taken.update(named)
            yield row, members


def read_edits(reading: ReadContext, uid: str) -> Iterator[ReadEdit]:
    """Yield the edits of one id."""
    return _read_edits(reading, uid, _by_id(reading).get(uid, []))


def _read_edits(reading: ReadContext, uid: str, objects: list[SampledObject]) -> Iterator[ReadEdit]:
    """The edits of one id. Copies are told beside the recorded actor: they come before what became of that."""
    actor = reading.drive.actors.get(uid)
    own = None if actor is None else original(objects, actor, reading.clock)
    for obj in objects:
        if obj is not own and obj.there.any():
            yield from _with_maneuvers(list(_new(ActorEditContext(reading, obj, actor))))
    if actor is not None:
        context = ActorEditContext(reading, own, actor)
        read = ((reader, reader.read(context)) for reader in ACTORS if reader.of_absent == context.is_gone)
        yield from _with_maneuvers([ReadEdit(edit, reader, context) for reader, edit in read if edit is not None])


def _with_maneuvers(items: list[ReadEdit]) -> Iterator[ReadEdit]:
    """Yield the edits of an object; where it notes maneuvers that lead where it goes, its path as it was before them, and
    they."""
    placed = next((item for item in items if isinstance(item.edit, PLACED)), None)
    edit, maneuvers = noted(placed.context, placed.edit) if placed is not None else (None, ())
    for item in items:
        if item is placed and maneuvers:
            yield item._replace(edit=edit or maneuvers[-1], maneuvers=tuple(maneuvers))
        else:
            yield item


def _new(context: ActorEditContext) -> Iterator[ReadEdit]:
    """The edit that adds an actor, and those that it needs beside, which are part of its line."""
    adds = next(reader for reader in NEW_ACTORS if reader.reads(context))
    new = adds.read(context)
    yield ReadEdit(new, adds, context)
    for reader in ACTORS:
        if (edit := reader.read_new(new.id, context)) is not None:
            yield ReadEdit(edit, reader, context, has_line=False)


def original(candidates: Iterable[SampledObject], actor: Actor, clock: Clock) -> SampledObject | None:
    """Return the object with an actor's id that is the actor itself: the one with the name that the import gave it,
    else one that goes where the actor was recorded, else the first. Found here and not by a handler, so that undo stays
    Blender's."""
    objects = list(candidates)
    recorded = recorded_poses(actor, clock)
    for obj in objects:
        if obj.is_original:
            return obj
    for obj in objects:
        if same(obj.poses, recorded).all():
            return obj
    return objects[0] if objects else None


@register
class RemoveReader(ActorReader[Remove]):
    """Reads removed actors."""

    of_absent = True

    def read(self, context: ActorEditContext) -> Remove | None:
        """An actor that is there at no frame was not removed."""
        return Remove(context.known.uid) if context.recorded_there.any() else None

    def line(self, edit: Remove, context: ActorEditContext) -> EditLine:
        """An actor whose object was deleted has the name that the list of actors gives it."""
        uid, obj = context.known.uid, context.obj
        names = context.names if obj is not None else (plain_names(context.reading.drive.actors)[uid], "")
        return line_of("ACTOR", uid, "REMOVE", Text("Removed"), names, context.recorded_there, context.clock, edit)


@register
class SwapReader(ActorReader[Swap]):
    """Reads appearances."""

    def read(self, context: ActorEditContext) -> Swap | None:
        obj = context.here
        return Swap(context.known.uid, obj.appearance, context.appearance_scene) if obj.appearance else None

    def line(self, edit: Swap, context: ActorEditContext) -> EditLine:
        actors = context.reading.drive.actors
        of_this_scene = edit.scene is None and edit.appearance in actors
        named = (
            plain_names(actors)[edit.appearance]
            if of_this_scene
            else Text("{actor} of {scene}", actor=edit.appearance, scene=Path(edit.scene or "").name)
        )
        return context.line("APPEARANCE", Text("Appearance of {actor}", actor=named), edit)


@register
class MoveReader(ActorReader[Move]):
    """Reads trajectories and places."""

    def read(self, context: ActorEditContext) -> Move | None:
        """The object's poses, where they are not those of the recorded actor on its ground."""
        obj, there = context.here, context.recorded_there
        if not differ(obj.poses, obj.there, context.lifted, there):
            return None
        if (shift := shift_of(context)) is not None:
            return shift
        shown = present(context.clock, obj.there) if (obj.there != there).any() else None
        return Move(context.known.uid, **context.path(), present=shown)

    def line(self, edit: Move, context: ActorEditContext) -> EditLine | None:
        """Return how it goes elsewhere; None where it was moved for its scale alone, which has a line of its own."""
        obj, there, raised = context.here, context.recorded_there, context.raised
        differs = (obj.there != there) | (obj.there & ~same(obj.poses, raised))
        if obj.scale_lift_m and not differs.any():
            return None
        words = joined(context.path_phrases())
        return context.line("MOVE", words or Text("Moved"), edit, differs)


def _apart(actor: Actor, obj: SampledObject, clock: Clock, there: BoolArray) -> FloatArray:
    """Return how far along an actor's axes an object mostly is from it (3,) at some frames (N,), in metres."""
    base = actor.world_from_actor.at(clock.times_s)
    return np.asarray(np.median((invert_pose(base) @ obj.poses)[there, :3, 3], axis=0))


def shift_of(context: ActorEditContext) -> Move | None:
    """Return the move of an actor whose trajectory is shifted along its path, displaced along its own axes and delayed,
    and no more; None where it goes otherwise."""
    obj, actor, clock = context.here, context.known, context.clock
    moves = actor.is_moving and is_path(actor.world_from_actor.positions)
    if not moves or obj.appearance or obj.scale_lift_m or obj.span is None or not obj.there.any():
        return None
    begins_s, first_s = float(clock.time_s(np.array(obj.span[0]))), float(actor.world_from_actor.times_s[0])
    # imported trajectories may have keys from the drive's first frame on
    starts = sorted({first_s, min(first_s, *context.reading.drive.time_s.values())})
    return next((move for start in starts if (move := _shift_by(context, begins_s - start)) is not None), None)


def _shift_by(context: ActorEditContext, later_s: float) -> Move | None:
    """Return that move of an actor that is delayed by ``later_s``; None where it goes otherwise."""
    obj, actor, clock = context.here, context.known, context.clock
    recorded = actor.world_from_actor
    later_s = round(later_s, LATER_DIGITS) if abs(later_s) > SAME_LATER_S else 0.0
    keys_s = merged_times(recorded.times_s, np.array(sorted(context.reading.drive.time_s.values())))
    framed = replace(actor, world_from_actor=Trajectory(keys_s, *sampled_keys(recorded, keys_s)))  # as Blender has it
    # beyond its keys a trajectory goes on as its last ones do, and Blender's are others
    keyed = (clock.times_s >= recorded.times_s[0] + later_s) & (clock.times_s <= recorded.times_s[-1] + later_s)
    there, drive = obj.there & keyed, context.reading.drive
    if not there.any():
        return None
    path, base = actor.world_from_actor.positions, actor.world_from_actor.at(clock.times_s - later_s)
    gone = arc_lengths_of(path, obj.poses[there, :3, 3]) - arc_lengths_of(path, base[there, :3, 3])
    by = _apart(shifted(actor, None, later_s, float(np.median(gone)), drive), obj, clock, there)
    candidates = (0.0, round(float(np.median(gone) + by[0]), AHEAD_DIGITS))
    for times, ahead_m in product((1.0, ALONG), candidates):
        by = _apart(shifted(actor, None, later_s, ahead_m, drive), obj, clock, there)
        offset = vector(np.round(by, OFFSET_DIGITS) + 0.0) if np.abs(by).max() > SAME_M else (0.0, 0.0, 0.0)
        after = shifted(actor, offset, later_s, ahead_m, drive)
        shifts = [shifted(each, offset, later_s, ahead_m, drive).world_from_actor for each in (actor, framed)]
        poses = (shift.at(clock.times_s) for shift in shifts)
        if any((near(p, obj.poses, times) if later_s or ahead_m else same(p, obj.poses))[there].all() for p in poses):
            break
    else:
        return None
    if not any(offset) and not later_s and not ahead_m:
        return None
    start, end = drive.window(after)
    then = (clock.times_s >= start) & (clock.times_s <= end)
    shown = None if (then == obj.there).all() else present(clock, obj.there) or Present()
    return Move(actor.uid, offset, later_s or None, ahead_m or None, present=shown)


@register
class ScaleReader(ActorReader[Scale]):
    """Reads sizes, also those of new actors."""

    def read(self, context: ActorEditContext) -> Scale | None:
        return self.read_new(context.known.uid, context)

    def read_new(self, new: str, context: ActorEditContext) -> Scale | None:
        factors = context.here.scaling.factors
        return Scale(new, factors) if factors != UNIT else None

    def line(self, edit: Scale, context: ActorEditContext) -> EditLine:
        return context.line("SCALE", Text("Scaled by {factors}", factors=scale_text(edit.factors)), edit)


@register
class DuplicateReader(NewActorReader[Duplicate]):
    """Reads copies with their source's appearance."""

    def reads(self, context: ActorEditContext) -> bool:
        """One with another appearance is an inserted actor."""
        return context.actor is not None and not context.here.appearance

    def read(self, context: ActorEditContext) -> Duplicate:
        """A copy that is displaced alike at all frames, in the world's axes or its own, keeps the actor's own
        trajectory between frames too."""
        obj, actor, base, there = context.here, context.known, context.recorded, context.recorded_there
        uid = context.reading.new_id(obj)
        changed = bool((obj.there != there).any())
        at = obj.there & there
        apart = (obj.poses - base)[at, :3, 3]
        if not changed and same_turn(obj.poses, base)[at].all():
            if (np.ptp(apart, axis=0) <= 2 * SAME_M).all():
                return Duplicate(actor.uid, uid, world_offset_m=vector(apart.mean(0)))
            beside = np.einsum("nji,nj->ni", base[at, :3, :3], apart)
            if (np.ptp(beside, axis=0) <= 2 * SAME_M).all():
                return Duplicate(actor.uid, uid, offset_m=vector(beside.mean(0)))
        when = present(context.clock, obj.there) if changed else None
        return Duplicate(actor.uid, uid, **context.path(), present=when)

    def line(self, edit: Duplicate, context: ActorEditContext) -> EditLine:
        words = context.path_phrases()
        words[:1] = [unmoved(phrase) for phrase in words[:1]]
        what = Text("Copied: {how}", how=cased(joined(words), LOWER)) if words else Text("Copied, in place")
        return context.line("COPY", what, edit)


@register
class InsertReader(NewActorReader[Insert]):
    """Reads inserted actors."""

    def reads(self, context: ActorEditContext) -> bool:
        """A copy with its source's appearance is a duplicate; without a recorded actor there may be a mesh."""
        obj = context.here
        return bool(obj.appearance) if context.actor is not None else not obj.mesh

    def read(self, context: ActorEditContext) -> Insert:
        obj = context.here
        path = ActorEditContext(context.reading, obj, None).path()
        when = present(context.clock, obj.there)
        uid = context.reading.new_id(obj)
        return Insert(obj.appearance or obj.uid, uid, context.appearance_scene, **path, present=when)

    def line(self, edit: Insert, context: ActorEditContext) -> EditLine:
        return context.line("INSERT", Text("Inserted"), edit)


@register
class InsertMeshReader(NewActorReader[InsertMesh]):
    """Reads meshes."""

    def reads(self, context: ActorEditContext) -> bool:
        """Its own surface is what is rendered."""
        return context.actor is None and bool(context.here.mesh)

    def read(self, context: ActorEditContext) -> InsertMesh:
        obj, reading = context.here, context.reading
        uid, when = reading.new_id(obj), present(context.clock, obj.there)
        return InsertMesh(reading.relative(obj.mesh), uid, obj.label or None, **context.path(), present=when)

    def line(self, edit: InsertMesh, context: ActorEditContext) -> EditLine:
        return context.line("MESH", Text("Mesh inserted"), edit)
