"""Reader of edits of the recorded actors and of new actors: it passes the objects of each id to the readers
of actors' edits."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

from ...core.errors import ScenarioError
from ...core.scenario.edit import Edit
from ...core.world.drive import Actor
from ..edits.lines import EditLine
from ..edits.reader import ACTORS, NEW_ACTORS, ActorReader, GroupReader, NewActorReader, ReadContext, Standing, register
from ..sampled.clock import Clock, recorded_poses
from ..sampled.poses import same
from ..sampled.scene import SampledObject, refusal


class ReadEdit(NamedTuple):
    """An edit, who read it, and off what. ``told``: whether it has a line of its own."""

    edit: Edit
    reader: ActorReader[Any] | NewActorReader[Any]
    standing: Standing
    told: bool = True


@register
class Actors(GroupReader):
    """Reads actors, those of each id together: the recorded one and its copies, or inserted ones."""

    group = "ACTOR"
    kinds = ("ACTOR",)
    by_id = True

    def edits(self, reading: ReadContext) -> Iterator[Edit]:
        """The edits of the recorded actors by their ids, then of inserted ones."""
        by_id = _by_id(reading)
        for uid in sorted(reading.drive.actors):
            yield from (found.edit for found in _found(reading, uid, by_id.pop(uid, [])))
        for uid, standing in by_id.items():
            yield from (found.edit for found in _found(reading, uid, standing))

    def lines(self, reading: ReadContext, uid: str) -> Iterator[EditLine]:
        """The edits of one id."""
        for found in _found(reading, uid, _by_id(reading).get(uid, [])):
            line = found.reader.line(found.edit, found.standing) if found.told else None
            if line is not None:
                yield line

    def edited_ids(self, reading: ReadContext) -> set[str]:
        """Recorded actors with an edit."""
        by_id = _by_id(reading)
        return {
            uid
            for uid in reading.drive.actors
            if any(
                isinstance(found.reader, ActorReader) and found.told
                for found in _found(reading, uid, by_id.get(uid, []))
            )
        }


def _by_id(reading: ReadContext) -> dict[str, list[SampledObject]]:
    by_id: dict[str, list[SampledObject]] = {}
    for obj in reading.sampled.of("ACTOR"):
        if fault := refusal(obj.name, obj.scaling):
            raise ScenarioError(fault)
        by_id.setdefault(obj.uid, []).append(obj)
    return by_id


def _found(reading: ReadContext, uid: str, objects: list[SampledObject]) -> Iterator[ReadEdit]:
    """The edits of one id. Copies are told beside the recorded actor: they come before what became of that."""
    actor = reading.drive.actors.get(uid)
    own = None if actor is None else original(objects, actor, reading.clock)
    for obj in objects:
        if obj is not own and obj.there.any():
            yield from _new(Standing(reading, obj, actor))
    if actor is not None:
        standing = Standing(reading, own, actor)
        for reader in ACTORS:
            if reader.of_absent == standing.is_gone and (edit := reader.read(standing)) is not None:
                yield ReadEdit(edit, reader, standing)


def _new(standing: Standing) -> Iterator[ReadEdit]:
    """The edit that adds an actor, and those that it needs beside, which are part of its line."""
    adds = next(reader for reader in NEW_ACTORS if reader.reads(standing))
    new = adds.read(standing)
    yield ReadEdit(new, adds, standing)
    for reader in ACTORS:
        if (edit := reader.read_new(new.id, standing)) is not None:
            yield ReadEdit(edit, reader, standing, told=False)


def original(standing: Iterable[SampledObject], actor: Actor, clock: Clock) -> SampledObject | None:
    """Which of the objects with one actor's id is the actor itself: the one with the name that the import gave it, else
    one that goes where the actor was recorded, else the first. Told here and not by a handler, so that undo
    stays Blender's."""
    objects = list(standing)
    recorded = recorded_poses(actor, clock)
    for obj in objects:
        if obj.is_original:
            return obj
    for obj in objects:
        if same(obj.poses, recorded).all():
            return obj
    return objects[0] if objects else None
