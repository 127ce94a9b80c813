"""Maneuvers of actors as keys, those of the trajectory that the scenario's edit makes, and as a note on the object."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import bpy
import numpy as np

from ...core.errors import ScenarioError, UnisimError
from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import Actor, Drive
from ...editing.edits.maneuvers import PLACED, ManeuverNote, maneuvered, path_members
from ...editing.edits.reader import ActorEditContext, ReadContext
from ...editing.motion.placement import meetings
from ...editing.motion.plausibility import ground_height
from ...editing.readers.actors import read_edits
from ...editing.sampled.clock import Clock, recorded_poses, recorded_there
from ...editing.sampled.scene import Sampled
from ...editing.sampled.source import DriveSource
from ..importing.drive import go
from ..objects.imported import add_actor, imported_objects, original_of, source_of, stand_at, title_of
from ..sampling.from_keys import Sampler
from ..sampling.stepping import shown_names


class OtherActors(NamedTuple):
    """What may be in the way: names (A), boxes (A, N, 5) in the plane, and when each is present (A, N)."""

    names: list[str]
    boxes: FloatArray
    there: BoolArray


Values = Mapping[str, Any]
"""A maneuver as JSON, without its actor."""


@dataclass(frozen=True)
class Maneuvering:
    """An actor's object as it is before a maneuver: its id in the scenario, the edit that says where it goes, and its
    maneuvers so far."""

    obj: bpy.types.Object
    uid: str
    context: ActorEditContext
    placed: PLACED | None
    note: ManeuverNote
    drive: Drive

    @staticmethod
    def of(scene: bpy.types.Scene, obj: bpy.types.Object, *leaders: bpy.types.Object) -> Maneuvering:
        """Return that of an object in a scene, which may follow ``leaders``. Raises `UnisimError`."""
        drive = source_of(scene).drive
        sampler = Sampler(scene, Clock.of(drive), shown_names(scene.view_layers[0].layer_collection), False)
        alike = (other for other in imported_objects(scene, "ACTOR") if other.unisim.uid == obj.unisim.uid)
        objects = {other.name: other for other in (*imported_objects(scene, "EGO"), *alike, *leaders)}
        sampled = Sampled(scene.name, sampler.clock, tuple(sampler.sample(objects[name]) for name in sorted(objects)))
        reading = ReadContext(sampled, drive, set(drive.actors))
        items = [item for item in read_edits(reading, obj.unisim.uid) if item.context.here.name == obj.name]
        placed = next((item for item in items if item.maneuvers or isinstance(item.edit, PLACED)), None)
        seen = next(one for one in sampled.objects if one.name == obj.name)
        if placed is None:
            context = ActorEditContext(reading, seen, drive.actors.get(seen.uid))
            return Maneuvering(obj, seen.uid, context, None, ManeuverNote({}, ()), drive)
        edit = placed.edit if isinstance(placed.edit, PLACED) else None
        note = ManeuverNote.of(seen.maneuvers) if placed.maneuvers else None
        uid = getattr(placed.edit, "id", getattr(placed.edit, "actor", ""))
        return Maneuvering(obj, uid, placed.context, edit, note or ManeuverNote(path_members(placed.edit), ()), drive)

    def after(self, values: Values) -> tuple[Actor, ManeuverNote]:
        """Return the actor after one more maneuver, and its note. Raises `UnisimError` in words for the window."""
        base = {} if values["type"] == "follow" else self.note.base  # where it went before does not matter
        note = ManeuverNote(base, (*self.note.maneuvers, values))
        try:
            return maneuvered(self.context, self.placed, self.uid, note), note
        except ScenarioError as fault:
            said = str(fault).split(": ", 1)[-1].replace(f'"{self.uid}"', self.obj.name)
            raise UnisimError(said[:1].upper() + said[1:]) from fault

    def without_last(self) -> Maneuvering:
        """Return the same before its last maneuver."""
        return replace(self, note=ManeuverNote(self.note.base, self.note.maneuvers[:-1]))

    def apply(self, values: Values) -> Actor:
        """Let the object do one more maneuver."""
        actor, note = self.after(values)
        go(self.obj, actor, self.drive, self.context.clock)
        self.obj.unisim.maneuvers = str(note)
        return actor

    def first_clear(self, candidates: Iterable[Values], traffic: OtherActors) -> int:
        """Return which of several maneuvers is the first in which the actor overlaps nothing, else the one in which it does
        at the fewest frames. Raises `UnisimError` where none can be."""
        best, fewest, faults = None, np.inf, []
        for number, values in enumerate(candidates):
            try:
                actor, _ = self.after(values)
            except UnisimError as fault:
                faults.append(fault)
                continue
            count = int(self._meetings(actor, traffic).sum())
            if count < fewest:
                best, fewest = number, count
            if count == 0:
                break
        if best is None:
            raise faults[0]
        return best

    def first_overlap(self, actor: Actor, traffic: OtherActors) -> tuple[str, float] | None:
        """Return the name of what an actor overlaps first, and when; None where that is nothing."""
        met = self._meetings(actor, traffic)
        if not met.any():
            return None
        at = int(met.any(0).argmax())
        return traffic.names[int(met[:, at].argmax())], float(self.context.clock.times_s[at])

    def _meetings(self, actor: Actor, traffic: OtherActors) -> BoolArray:
        clock = self.context.clock
        present = recorded_there(actor, self.drive, clock)
        return meetings(recorded_poses(actor, clock), present, actor.size_m, traffic.boxes, traffic.there)


_grounds: dict[object, float | None] = {}
"""Heights of the ground by log, frame and place: they take reading a sweep."""


def scenario_id(scene: bpy.types.Scene, obj: bpy.types.Object) -> str:
    """Return what a scenario calls an actor."""
    is_recorded = not obj.unisim.mesh and original_of(scene, "ACTOR", obj.unisim.uid) == obj
    return str(obj.unisim.uid) if is_recorded else title_of(obj)


def best_seen(drive: Drive, uids: Iterable[str]) -> str:
    """Return which of some actors is near the ego vehicle for the longest time."""
    clock = Clock.of(drive)
    ego = drive.world_from_ego.positions_at(clock.times_s)

    def nearness(uid: str) -> float:
        actor = drive.actors[uid]
        away = np.linalg.norm(recorded_poses(actor, clock)[:, :3, 3] - ego, axis=1)
        return float((recorded_there(actor, drive, clock) / np.maximum(away, 8.0)).sum())

    return max(uids, key=nearness)


def inserted_at(
    scene: bpy.types.Scene, source: DriveSource, name: str, uid: str, pose: FloatArray, frame: int
) -> bpy.types.Object:
    """Return a new object for an actor of the drive at a pose (4, 4), on the ground there."""
    actor = source.drive.actors[uid]
    obj = add_actor(scene, name, actor, uid)
    place = (str(source.log_path), frame, *pose[:3, 3].round(2).tolist())
    if place not in _grounds:
        _grounds[place] = ground_height(source, pose[:3, 3], frame)
    ground = _grounds[place]
    stand_at(obj, pose)
    obj.location.z = (float(pose[2, 3]) if ground is None else ground) + float(actor.appearance_size_m[2]) / 2
    return obj
