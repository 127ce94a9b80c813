"""Maneuvers that objects note. They count as long as they lead where the object goes, whatever was edited since."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from ...core.errors import ScenarioError
from ...core.geometry import BoolArray, Trajectory
from ...core.scenario import build, plain
from ...core.scenario.context import EditContext, with_actor
from ...core.scenario.edit import EDITS, Edit
from ...core.scenario.edits import Duplicate, Follow, Insert, InsertMesh, Move
from ...core.scenario.motion.keys import PATH_MEMBERS
from ...core.scenario.motion.maneuvers import Maneuver
from ...core.scenario.motion.trajectories import beside
from ...core.scenario.types import Scenario
from ...core.world.drive import Actor, Appearance
from ..sampled.scene import SampledObject, near, same
from ..sampled.source import scene_actors
from .reader import GROUPS, ActorEditContext, ReadContext

PATH = (*PATH_MEMBERS, "offset_m", "world_offset_m", "later_s", "ahead_m", "turn_deg", "time_offset_s")
"""Members of edits that say where an actor goes."""
PLACED = Move | Duplicate | Insert | InsertMesh


@dataclass(frozen=True)
class ManeuverNote:
    """Maneuvers of an object, one after the other, and the members of the edit that says where it went before them. The
    maneuvers' actor is left out: it is the object."""

    base: Mapping[str, Any]
    maneuvers: tuple[Mapping[str, Any], ...]

    @staticmethod
    def of(text: str) -> ManeuverNote | None:
        """Return what an object notes; None where that is nothing."""
        return ManeuverNote(**json.loads(text)) if text else None

    def __str__(self) -> str:
        return json.dumps({"base": self.base, "maneuvers": self.maneuvers})

    def edits(self, uid: str) -> list[Maneuver]:
        """Return the maneuvers as edits of an actor."""
        return [build(EDITS[values["type"]], {**_without(values, "type"), "actor": uid}) for values in self.maneuvers]

    @staticmethod
    def of_edits(edits: Iterable[Edit], uid: str) -> ManeuverNote | None:
        """Return the note for an actor of a scenario's edits; None where it has no maneuvers."""
        own = [edit for edit in edits if getattr(edit, "id", getattr(edit, "actor", None)) == uid]
        maneuvers = tuple(_without(plain(edit), "actor") for edit in own if isinstance(edit, Maneuver))
        placed = [edit for edit in own if isinstance(edit, PLACED)]
        return ManeuverNote(path_members(placed[0]) if placed else {}, maneuvers) if maneuvers else None


def _without(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in values.items() if key != name}


def path_members(edit: Edit) -> dict[str, Any]:
    """Return the members of an edit that say where its actor goes, as JSON."""
    return {key: value for key, value in plain(edit).items() if key in PATH}


def with_path(edit: Edit, base: Mapping[str, Any]) -> Edit:
    """Return an edit with other members that say where its actor goes, of those that it can have."""
    names = {field.name for field in fields(edit)}
    rest = {key: value for key, value in plain(edit).items() if key not in PATH}
    new: Edit = build(Edit, rest | {key: value for key, value in base.items() if key in names})
    return new


def maneuvered(context: ActorEditContext, placed: PLACED | None, uid: str, note: ManeuverNote) -> Actor:
    """Return the actor that a note makes of a context's, in a drive whose ego vehicle and leaders go as in the sampled
    scene. ``placed`` is the edit that says where it goes, where there is one. Raises `ScenarioError`."""
    reading, obj, edits = context.reading, context.here, note.edits(uid)
    known = None if isinstance(placed, Insert | InsertMesh) else context.actor
    drive = replace(reading.drive, cameras={}, lidars={})  # no maneuver asks for sensors
    stub = EditContext(Scenario("", "", edits=tuple(edits)), drive, scene_actors)
    for edit in (edit for reader in GROUPS if "EGO" in reader.kinds for edit in reader.edits(reading)):
        drive = edit.apply(drive, "", stub)
    for edit in edits:
        if isinstance(edit, Follow) and (leader := _as_sampled(edit.leader, reading)) is not None:
            drive = with_actor(drive, leader)
    if known is not None:
        rise = float(context.appearance_size_m[2] - known.size_m[2]) / 2 if obj.appearance else 0.0
        path = beside(known.world_from_actor, (0.0, 0.0, rise), note.base.get("world_offset_m"), None)
        start, end, label = known.start_s, known.end_s, known.label
    else:
        path = Trajectory.from_poses(context.clock.times_s[:1], obj.poses[:1])
        (start, end), label = stub.presence(None, ""), obj.label
    actor = Actor(uid, label, np.array(obj.size_m), path, start, end, False, Appearance(uid))
    drive = with_actor(drive, actor)
    base = _without(note.base, "world_offset_m")
    for edit in (*([with_path(Move(uid), base)] if base else []), *edits):
        drive = edit.apply(drive, "maneuvers", stub)
    return drive.actors[uid]


def _as_sampled(uid: str, reading: ReadContext) -> Actor | None:
    """Return an actor as its object goes; None where it has none, or goes as recorded."""
    obj = next((o for o in reading.sampled.of("ACTOR") if uid == (o.uid if o.is_original else o.title)), None)
    known, times = reading.drive.actors.get(uid), reading.clock.times_s
    if obj is None or not obj.there.any():
        return None
    if known is not None and same(known.world_from_actor.at(times), obj.poses)[obj.there].all():
        return None
    at = np.flatnonzero(obj.there)
    path = Trajectory.from_poses(times[at], obj.poses[at])
    return Actor(uid, obj.label, np.array(obj.size_m), path, times[at[0]], times[at[-1]], True, Appearance(uid))


def leads_to(actor: Actor, obj: SampledObject, reading: ReadContext, agree: Callable[..., BoolArray] = same) -> bool:
    """Return whether an object goes where an actor goes, when that is present."""
    times, (start, end) = reading.clock.times_s, reading.drive.window(actor)
    there = (times >= start) & (times <= end)
    return bool((there == obj.there).all() and agree(actor.world_from_actor.at(times), obj.poses)[there].all())


def noted(context: ActorEditContext, placed: Edit) -> tuple[Edit | None, list[Maneuver]]:
    """Return the edit that says where an object goes as it was before the object's maneuvers, None where it went as
    recorded, and these; the edit as it is and none where they do not lead to where the object goes."""
    note = ManeuverNote.of(context.here.maneuvers)
    if note is None or not isinstance(placed, PLACED):
        return placed, []
    uid = placed.actor if isinstance(placed, Move) else placed.id
    try:
        agree = near if note.base.get("later_s") or note.base.get("ahead_m") else same
        if leads_to(maneuvered(context, placed, uid, note), context.here, context.reading, agree):
            return None if isinstance(placed, Move) and not note.base else with_path(placed, note.base), note.edits(uid)
    except (ScenarioError, ValueError, KeyError, TypeError):  # the last ones: a note of another version
        pass
    return placed, []
