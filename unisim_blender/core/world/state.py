"""The state of the world over one exposure: all that a sensor can see, and nothing of the drive that it comes from.

A `WorldState` is small and immutable. Renderers depend on it alone; log replay, an edited scenario, a Blender scene and a
simulator are sources of it. See `drive.py` for frames of reference and units.
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
    """The world from ``start_s`` to ``end_s``, seconds, the window of one exposure.

    ``actors`` are the active ones in the order of their ids: each is present at some time of the window, its times of presence
    are clipped to the window, and its trajectory has the keys that cover the window. ``world_from_ego`` is the ego vehicle's
    trajectory, cut the same way. ``static_copies`` are boxes of the static world that stand elsewhere, too; inside
    ``removed_boxes`` the static world is empty above the ground.

    States are equal where their digests are.
    """

    start_s: float
    end_s: float
    world_from_ego: Trajectory
    actors: tuple[Actor, ...] = ()
    static_copies: tuple[StaticCopy, ...] = ()
    removed_boxes: tuple[Box, ...] = ()

    @cached_property
    def digest(self) -> str:
        """A digest, 32 hexadecimal digits, that differs where anything in the state differs."""
        return hashlib.blake2b(b"".join(self._parts()), digest_size=16).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, WorldState) and self.digest == other.digest

    def __hash__(self) -> int:
        return hash(self.digest)

    def restricted(self, uids: Collection[str]) -> WorldState:
        """The state with the actors of these ids alone."""
        return replace(self, actors=tuple(actor for actor in self.actors if actor.uid in uids))

    def _parts(self) -> Iterator[bytes]:
        """Yield the content in parts, each of a length that follows from what comes before it."""
        yield np.array([self.start_s, self.end_s, len(self.actors), len(self.static_copies), len(self.removed_boxes)]).tobytes()
        yield self.world_from_ego.content()
        for actor in self.actors:
            appearance = actor.appearance
            words = (actor.uid, actor.label, appearance.actor, appearance.scene, appearance.mesh)
            flags = (actor.is_moving, actor.inserted, actor.is_ego_body)
            yield json.dumps(words).encode() + bytes(flags)
            yield np.array([*actor.size_m, *actor.scale, actor.start_s, actor.end_s]).tobytes()
            yield actor.world_from_actor.content()
        for copy in self.static_copies:
            yield json.dumps(copy.uid).encode()
            yield from _box_parts(copy.source)
            yield np.ascontiguousarray(copy.world_from_target, np.float64).tobytes()
        for box in self.removed_boxes:
            yield from _box_parts(box)


class StateSource(Protocol):
    """Where states come from: log replay, an edited scenario, a Blender scene, a simulator."""

    def state(self, start_s: float, end_s: float) -> WorldState:
        """Return the world from ``start_s`` to ``end_s``, seconds."""
        ...


def _box_parts(box: Box) -> Iterator[bytes]:
    yield np.ascontiguousarray(box.world_from_box, np.float64).tobytes()
    yield np.ascontiguousarray(box.size_m, np.float64).tobytes()
