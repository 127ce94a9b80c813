"""The active actors of a state by the scene of their appearances, and copied and removed boxes of space."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import SceneError
from ..geometry import Trajectory
from ..meshes.hits import MeshActors
from ..world.drive import Actor, Appearance, Box, StaticCopy
from ..world.state import WorldState


@dataclass(frozen=True)
class ActorSet:
    """Actors whose appearances come from one scene, and each one's row of that scene's tables."""

    actors: tuple[Actor, ...]
    rows: tuple[int, ...]

    @property
    def uids(self) -> tuple[str, ...]:
        """Their ids."""
        return tuple(actor.uid for actor in self.actors)


@dataclass(frozen=True)
class ActiveActors:
    """``own`` are actors with appearances of the scene itself, ``foreign`` those of other scenes by their paths, in
    order; ``mesh_actors`` are meshes. ``removals`` are boxes in which nothing stands above the ground; ``targets`` are
    boxes of copies, as actors that stand still throughout, and ``sources`` where each one's content is."""

    own: ActorSet
    foreign: dict[str, ActorSet] = field(default_factory=dict)
    removals: tuple[Box, ...] = ()
    targets: tuple[Actor, ...] = ()
    sources: tuple[Box, ...] = ()
    mesh_actors: MeshActors = field(default_factory=lambda: MeshActors(()))

    @property
    def uids(self) -> tuple[str, ...]:
        """Every actor's id: own ones, then foreign actors', then meshes'; instance n + 1 is the n-th of them."""
        return (
            self.own.uids
            + tuple(uid for actor_set in self.foreign.values() for uid in actor_set.uids)
            + self.mesh_actors.uids
        )


def active_actors(state: WorldState, appearances: Mapping[str, Sequence[str] | None]) -> ActiveActors:
    """The active actors of a state. ``appearances`` are the actors that the rows of each scene's tables belong to, the
    scene's own under "", others' under their paths, None for a scene that is one field: it has no own actors, and what
    a state says of them is left out. Raises `SceneError`."""
    one_field = appearances[""] is None
    actors = [a for a in state.actors if not one_field or a.appearance.scene or a.appearance.mesh]
    foreign = {}
    for path in sorted({a.appearance.scene for a in actors if a.appearance.scene}):
        if path not in appearances:
            raise SceneError(f"{path}: this trained scene is needed for an inserted actor and was not loaded")
        foreign[path] = _actor_set(appearances[path], [a for a in actors if a.appearance.scene == path])
    return ActiveActors(
        own=_actor_set(appearances[""], [a for a in actors if not a.appearance.scene and not a.appearance.mesh]),
        foreign=foreign,
        removals=state.removed_boxes,
        targets=tuple(_target(state, copy) for copy in state.static_copies),
        sources=tuple(copy.source for copy in state.static_copies),
        # ego bodies last: the numbers of other meshes are the same for sensors that do not see them
        mesh_actors=MeshActors(sorted((a for a in actors if a.appearance.mesh), key=lambda a: a.is_ego_body)),
    )


def _actor_set(appearances: Sequence[str] | None, actors: list[Actor]) -> ActorSet:
    rows = {uid: row for row, uid in enumerate(appearances or ())}
    for actor in actors:
        if actor.appearance.actor not in rows:
            where = f" at {actor.appearance.scene}" if actor.appearance.scene else ""
            raise SceneError(
                f"actor {actor.uid!r} has the appearance of {actor.appearance.actor!r}, "
                f"which the trained scene{where} does not hold"
            )
    return ActorSet(tuple(actors), tuple(rows[actor.appearance.actor] for actor in actors))


def _target(state: WorldState, copy: StaticCopy) -> Actor:
    """A copy's box as an actor that stands still throughout."""
    trajectory = Trajectory.from_poses(np.zeros(1), copy.world_from_target[None])
    return Actor(
        copy.uid, "Static", copy.source.size_m, trajectory, state.start_s, state.end_s, False, Appearance(copy.uid)
    )
