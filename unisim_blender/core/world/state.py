"""The state of the world during one exposure: all that a sensor can see, independent of the drive that it comes from.

A `WorldState` is small and immutable. Renderers depend on it alone. Its sources are log replay, an edited scenario, a
Blender scene or a simulator (`StateSource`). See `drive.py` for frames of reference and units.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from ..geometry import Trajectory
from .drive import Actor, Box, StaticCopy


@dataclass(frozen=True, eq=False)
class WorldState:
    """The world from ``start_s`` to ``end_s``, in seconds: the window of one exposure.

    ``actors`` are those present at some time of the window, in the order of their ids. Their presence is clipped to the
    window, and their trajectories hold the keys that cover it, as does ``world_from_ego``, the ego vehicle's.
    ``static_copies`` are copied boxes of the static world; inside ``removed_boxes`` the static world is empty
    above the ground.

    States are equal if their digests are.
    """

    start_s: float
    end_s: float
    world_from_ego: Trajectory
    actors: tuple[Actor, ...] = ()
    static_copies: tuple[StaticCopy, ...] = ()
    removed_boxes: tuple[Box, ...] = ()

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
        for copy in self.static_copies:
            yield copy.content()
        for box in self.removed_boxes:
            yield box.content()


class StateSource(Protocol):
    """A source of states: log replay, an edited scenario, a Blender scene, a simulator."""

    def state(self, start_s: float, end_s: float) -> WorldState:
        """Return the world from ``start_s`` to ``end_s``, seconds."""
        ...
