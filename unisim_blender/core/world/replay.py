"""A recorded or edited drive as a source of states."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from ..geometry import FloatArray, make_pose
from .drive import Actor, Box, Drive
from .state import WorldState


class DriveStates:
    """The states of a recorded or edited drive.

    ``parked`` are the boxes, by actor id, of actors that stood still throughout the recording; the renderer's backend
    has them. Where an edit removes or moves such an actor, its box becomes a removed box: no sensor ever saw what is
    inside, so the static field has nothing to show there.
    """

    def __init__(self, drive: Drive, parked: Mapping[str, Box]) -> None:
        self.drive, self.parked = drive, parked
        self._actors = tuple(with_windows(drive, drive.actors.values()))
        self._starts_s = np.array([actor.start_s for actor in self._actors])
        self._ends_s = np.array([actor.end_s for actor in self._actors])
        self._removed = drive.static_removals + tuple(
            box for uid, box in parked.items() if not _stands_in(drive.actors.get(uid), box)
        )

    def state(self, start_s: float, end_s: float) -> WorldState:
        """See `StateSource`."""
        active = np.flatnonzero((self._ends_s >= start_s) & (self._starts_s <= end_s)).tolist()
        starts, ends = np.maximum(self._starts_s, start_s).tolist(), np.minimum(self._ends_s, end_s).tolist()
        actors = (
            replace(
                self._actors[i],
                world_from_actor=self._actors[i].world_from_actor.between(start_s, end_s),
                start_s=starts[i],
                end_s=ends[i],
            )
            for i in active
        )
        return WorldState(
            start_s,
            end_s,
            self.drive.world_from_ego.between(start_s, end_s),
            tuple(actors),
            self.drive.static_copies,
            self._removed,
        )


def with_windows(drive: Drive, actors: Iterable[Actor]) -> list[Actor]:
    """Return actors with finite presence (`Drive.window`), in the order of their ids: overlapping actors then composite
    alike whatever order the drive has."""
    windows = ((actor, drive.window(actor)) for actor in sorted(actors, key=lambda a: a.uid))
    return [replace(actor, start_s=start, end_s=end) for actor, (start, end) in windows]


def over_whole_frames(drive: Drive) -> Drive:
    """Return a drive whose actors are present while the sensors of a frame measure, shortly before the first frame and after the
    last one, too (`Drive.window`); in the drive's own order."""
    actors = {actor.uid: actor for actor in with_windows(drive, drive.actors.values())}
    return replace(drive, actors={uid: actors[uid] for uid in drive.actors})


def parked_boxes(recorded: Drive) -> dict[str, Box]:
    """Return the boxes of actors that stood still throughout a recording, by their ids."""
    return {uid: Box(first_pose(actor), actor.size_m) for uid, actor in recorded.actors.items() if not actor.is_moving}


def first_pose(actor: Actor) -> FloatArray:
    """Return an actor's pose (4, 4) at its first key."""
    trajectory = actor.world_from_actor
    return make_pose(trajectory.positions[0], trajectory.quaternions_wxyz[0])


def _stands_in(actor: Actor | None, box: Box) -> bool:
    """Return whether an actor stands in the box that it was recorded in, at its recorded size."""
    return (
        actor is not None
        and not actor.is_moving
        and not actor.is_scaled
        and np.array_equal(first_pose(actor), box.world_from_box)
    )
