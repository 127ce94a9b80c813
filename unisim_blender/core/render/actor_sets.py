"""Who is on: a state's actors, copied and removed boxes of space, and whose looks they have. A tracer makes its tables of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import SceneError
from ..geometry import Trajectory
from ..meshes.meeting import Extras
from ..world.drive import Actor, Box, Look, StaticCopy
from ..world.state import WorldState


@dataclass(frozen=True)
class Troupe:
    """Actors whose looks come from one scene, and each one's row of that scene's tables."""

    actors: tuple[Actor, ...]
    rows: tuple[int, ...]

    @property
    def uids(self) -> tuple[str, ...]:
        """Their ids."""
        return tuple(actor.uid for actor in self.actors)


@dataclass(frozen=True)
class Cast:
    """``own`` are actors with looks of the scene itself, ``guests`` those of other scenes by their paths, in order; ``extras``
    are meshes. ``removals`` are boxes in which nothing stands above the ground; ``targets`` are boxes of copies, as actors that
    stand still throughout, and ``sources`` where each one's content is."""

    own: Troupe
    guests: dict[str, Troupe] = field(default_factory=dict)
    removals: tuple[Box, ...] = ()
    targets: tuple[Actor, ...] = ()
    sources: tuple[Box, ...] = ()
    extras: Extras = field(default_factory=lambda: Extras(()))

    @property
    def uids(self) -> tuple[str, ...]:
        """Every actor's id: own ones, then guests', then meshes'; instance n + 1 is the n-th of them."""
        return self.own.uids + tuple(uid for troupe in self.guests.values() for uid in troupe.uids) + self.extras.uids


def gather_cast(state: WorldState, looks: Mapping[str, Sequence[str] | None]) -> Cast:
    """The cast of a state. ``looks`` are the actors that the rows of each scene's tables belong to, the scene's own under "",
    others' under their paths, None for a scene that is one field: it has no own actors, and what a state says of them is left
    out. Raises `SceneError`."""
    one_field = looks[""] is None
    actors = [a for a in state.actors if not one_field or a.look.scene or a.look.mesh]
    guests = {}
    for path in sorted({a.look.scene for a in actors if a.look.scene}):
        if path not in looks:
            raise SceneError(f"{path}: this trained scene is needed for an inserted actor and was not loaded")
        guests[path] = _troupe(looks[path], [a for a in actors if a.look.scene == path])
    return Cast(
        own=_troupe(looks[""], [a for a in actors if not a.look.scene and not a.look.mesh]),
        guests=guests,
        removals=state.removed_boxes,
        targets=tuple(_target(state, copy) for copy in state.static_copies),
        sources=tuple(copy.source for copy in state.static_copies),
        # ego bodies last: the numbers of other meshes are the same for sensors that do not see them
        extras=Extras(sorted((a for a in actors if a.look.mesh), key=lambda a: a.is_ego_body)),
    )


def _troupe(looks: Sequence[str] | None, actors: list[Actor]) -> Troupe:
    rows = {uid: row for row, uid in enumerate(looks or ())}
    for actor in actors:
        if actor.look.actor not in rows:
            where = f" at {actor.look.scene}" if actor.look.scene else ""
            raise SceneError(
                f"actor {actor.uid!r} has the look of {actor.look.actor!r}, which the trained scene{where} does not hold"
            )
    return Troupe(tuple(actors), tuple(rows[actor.look.actor] for actor in actors))


def _target(state: WorldState, copy: StaticCopy) -> Actor:
    """A copy's box as an actor that stands still throughout."""
    way = Trajectory.from_poses(np.zeros(1), copy.world_from_target[None])
    return Actor(copy.uid, "Static", copy.source.size_m, way, state.start_s, state.end_s, False, Look(copy.uid))
