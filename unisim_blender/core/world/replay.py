"""States of the world during one exposure: all that a sensor can see. A recorded or edited drive is a source of them,
and of its actors' trajectories as arrays.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray, Trajectory, make_pose, slerp
from .classes import motion_of
from .drive import Actor, Box, Drive, StaticCopy
from .light import Sunlight
from .weather import Weather


@dataclass(frozen=True, eq=False)
class WorldState:
    """The world from ``start_s`` to ``end_s``, in seconds: the window of one exposure.

    ``actors`` are those present at some time of the window, in the order of their ids. Their presence is clipped to the
    window, and their trajectories hold the keys that cover it, as does ``world_from_ego``, the ego vehicle's.
    ``static_copies`` are copied boxes of the static world; inside ``removed_boxes`` the static world is empty
    above the ground. ``weather`` and ``light`` are those of the window's middle; None where they change nothing.

    States are equal if their digests are.
    """

    start_s: float
    end_s: float
    world_from_ego: Trajectory
    actors: tuple[Actor, ...] = ()
    static_copies: tuple[StaticCopy, ...] = ()
    removed_boxes: tuple[Box, ...] = ()
    weather: Weather | None = None
    light: Sunlight | None = None

    @cached_property
    def digest(self) -> str:
        """Digest of the whole content, 32 hexadecimal digits."""
        return hashlib.blake2b(b"".join(self._parts()), digest_size=16).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, WorldState) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def restricted(self, uids: Collection[str]) -> WorldState:
        """Return the state with only the actors of these ids."""
        return replace(self, actors=tuple(actor for actor in self.actors if actor.uid in uids))

    def with_changes_alone(self) -> WorldState:
        """Return the state without its light where that changes nothing, and without changed actors that are not there."""
        if self.light is None:
            return self
        there = {actor.uid for actor in self.actors}
        light = replace(self.light, changed=tuple(uid for uid in self.light.changed if uid in there))
        if not (light.changed or self.removed_boxes or self.static_copies):
            return replace(self, light=None)
        return self if light == self.light else replace(self, light=light)

    def _parts(self) -> Iterator[bytes]:
        """Yield the content as parts of bytes; the length of each follows from those before it, so joining
        them loses nothing."""
        yield np.array(
            [self.start_s, self.end_s, len(self.actors), len(self.static_copies), len(self.removed_boxes)]
        ).tobytes()
        yield self.world_from_ego.content()
        for actor in self.actors:
            appearance = actor.appearance
            words = (actor.uid, actor.label, appearance.actor, appearance.scene, appearance.mesh)
            flags = (actor.is_moving, actor.inserted, actor.is_ego_body)
            yield json.dumps(words).encode() + bytes(flags)
            yield np.array([*actor.size_m, *actor.scale, actor.start_s, actor.end_s]).tobytes()
            yield actor.world_from_actor.content()
            if motion_of(actor.label) == "deforming" or (self.weather is not None and self.weather.wet):
                yield np.float64(round(actor.world_from_actor.start_walked_m, 6)).tobytes()
            for lamp in actor.lamps:
                yield lamp.content
        for copy in self.static_copies:
            yield copy.content()
        for box in self.removed_boxes:
            yield box.content()
        if self.weather is not None:
            yield json.dumps(self.weather.to_dict()).encode()
        if self.light is not None:
            yield json.dumps(self.light.to_json()).encode()


MAX_COMPARISONS = 1 << 24
"""Largest number of comparisons of keys with times that are made at once; beyond it, as for a long drive, rows are
searched one by one."""


@dataclass(frozen=True)
class PaddedKeys:
    """Trajectory keys of A actors, padded to K: times_s (A, K), inf where there is none; positions (A, K, 3), world
    frame; quaternions_wxyz (A, K, 4); lengths (A,), the number of keys of each; walked_m (A, K), `Trajectory.walked_m`."""

    times_s: FloatArray
    positions: FloatArray
    quaternions_wxyz: FloatArray
    lengths: NDArray[np.int32]
    walked_m: FloatArray

    @staticmethod
    def of(actors: Sequence[Actor]) -> PaddedKeys:
        """Return the keys of actors, one row each."""
        return PaddedKeys.of_trajectories([actor.world_from_actor for actor in actors])

    @staticmethod
    def of_trajectories(trajectories: Sequence[Trajectory]) -> PaddedKeys:
        """Return the keys of trajectories, one row each."""
        lengths = np.array([len(trajectory.times_s) for trajectory in trajectories], np.int32)
        shape = len(trajectories), int(lengths.max(initial=1))
        times, positions, walked = np.full(shape, np.inf), np.zeros((*shape, 3)), np.zeros(shape)
        quaternions = np.tile([1.0, 0, 0, 0], (*shape, 1))
        real = np.arange(shape[1]) < lengths[:, None]
        if trajectories:
            times[real] = np.concatenate([trajectory.times_s for trajectory in trajectories])
            positions[real] = np.concatenate([trajectory.positions for trajectory in trajectories])
            walked[real] = np.concatenate([trajectory.walked_m for trajectory in trajectories])
            quaternions[real] = np.concatenate([trajectory.quaternions_wxyz for trajectory in trajectories])
        return PaddedKeys(times, positions, quaternions, lengths, walked)

    def positions_at(self, times_s: FloatArray) -> FloatArray:
        """Return the actors' positions (A, T, 3), world frame, at times (T,): `Trajectory.positions_at` of each."""
        row, lower, upper, u = self._between(times_s)
        start = self.positions[row, lower]
        return np.asarray(start + u[..., None] * (self.positions[row, upper] - start))

    def quaternions_at(self, times_s: FloatArray) -> FloatArray:
        """Return the actors' rotations, quaternions wxyz (A, T, 4), at times (T,)."""
        row, lower, upper, u = self._between(times_s)
        return slerp(self.quaternions_wxyz[row, lower], self.quaternions_wxyz[row, upper], u)

    def _between(
        self, times_s: FloatArray
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], FloatArray]:
        """Return rows (A, 1), the keys (A, T) before times (T,) and after, and how far each time is between them."""
        single = self.lengths[:, None] == 1
        if self.times_s.size * len(times_s) <= MAX_COMPARISONS:
            before = (self.times_s[:, None] <= times_s[None, :, None]).sum(-1) - 1
        else:
            before = np.array([np.searchsorted(row, times_s, "right") for row in self.times_s]) - 1
        lower = np.clip(before, 0, np.maximum(self.lengths - 2, 0)[:, None])
        upper = np.where(single, 0, lower + 1)
        row = np.arange(len(self.lengths))[:, None]
        first = self.times_s[row, lower]
        span = np.where(single, 1.0, self.times_s[row, upper] - self.times_s[row, lower])
        return row, lower, upper, np.where(single, 0.0, (times_s - first) / span)


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
        middle_s, sun = (start_s + end_s) / 2, self.drive.sun
        active = np.flatnonzero((self._ends_s >= start_s) & (self._starts_s <= end_s)).tolist()
        starts, ends = np.maximum(self._starts_s, start_s).tolist(), np.minimum(self._ends_s, end_s).tolist()
        actors = (
            replace(
                self._actors[i],
                world_from_actor=self._actors[i].world_from_actor.between(start_s, end_s),
                start_s=starts[i],
                end_s=ends[i],
                lamps=tuple(lamp.at(middle_s) for lamp in self._actors[i].lamps),
            )
            for i in active
        )
        light = None
        if sun is not None:
            uids = (self._actors[i].uid for i in active)
            light = Sunlight(sun.at(middle_s), tuple(uid for uid in uids if uid in self.drive.edited))
        state = WorldState(
            start_s,
            end_s,
            self.drive.world_from_ego.between(start_s, end_s),
            tuple(actors),
            self.drive.static_copies,
            self._removed,
            None if self.drive.weather is None else self.drive.weather.at(middle_s),
            light,
        )
        return state.with_changes_alone()


def with_windows(drive: Drive, actors: Iterable[Actor]) -> list[Actor]:
    """Return actors with finite presence (`Drive.window`), in the order of their ids: overlapping actors then composite
    alike whatever order the drive has."""
    windows = ((actor, drive.window(actor)) for actor in sorted(actors, key=lambda a: a.uid))
    return [replace(actor, start_s=start, end_s=end) for actor, (start, end) in windows]


def over_whole_frames(drive: Drive) -> Drive:
    """Return a drive whose actors are present while the sensors of a frame measure, shortly before the first frame and
    after the last one, too (`Drive.window`); in the drive's own order."""
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
