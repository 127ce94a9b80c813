"""The active actors as the kernels read them: boxes on their trajectories, copied and removed boxes of space."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....geometry import invert_pose
from ....sensors.bounds import Bounds
from ....sensors.rays import Rays
from ....world.drive import Actor
from ....world.keys import PaddedKeys
from ...actor_sets import ActiveActors
from .scene import CompiledScene
from .structs import ActiveActorsStruct, ActorSetStruct, address, doubles, floats


class _BoxTrajectories:
    """Trajectories of boxes whose appearances come from one scene."""

    def __init__(self, scene: CompiledScene, actors: Sequence[Actor], rows: Sequence[int]) -> None:
        self.scene, self.count = scene, len(actors)
        self.bounds = Bounds(actors)
        keys = PaddedKeys.of(actors)
        self.keys = keys.times_s.shape[1]
        self.arrays: dict[str, NDArray[Any]] = {
            "times": keys.times_s,
            "lengths": keys.lengths,
            "positions": keys.positions,
            "quaternions": keys.quaternions_wxyz,
            "sizes": floats(np.array([a.appearance_size_m for a in actors]).reshape(-1, 3)),
            "start": doubles([a.start_s for a in actors]),
            "end": doubles([a.end_s for a in actors]),
            "rows": np.array(rows, np.int32),
            "scales": floats(np.array([a.scale for a in actors]).reshape(-1, 3)),
        }

    def struct(self, candidates: Sequence[int]) -> tuple[ActorSetStruct, Any]:
        """The structure for rays that can hit only these boxes, and the array that it points to
        beside this object's."""
        numbers = np.array(candidates, np.int32)
        scene = ctypes.pointer(self.scene.struct)
        pointers = {name: address(array) for name, array in self.arrays.items()}
        return ActorSetStruct(
            scene, self.count, self.keys, **pointers, candidates=address(numbers), candidate_count=len(numbers)
        ), numbers


class CompiledActors:
    """The active actors of a state, with appearances of ``scene`` and of ``others`` by their paths."""

    def __init__(self, active: ActiveActors, scene: CompiledScene, others: dict[str, CompiledScene]) -> None:
        scenes = [scene, *(others[path] for path in active.foreign)]
        self.actor_sets = [
            _BoxTrajectories(own, actor_set.actors, actor_set.rows)
            for own, actor_set in zip(scenes, (active.own, *active.foreign.values()), strict=True)
        ]
        self.copies = _BoxTrajectories(scene, active.targets, [0] * len(active.targets)) if active.targets else None
        self._sources = doubles([box.world_from_box[:3] for box in active.sources])
        self._removals = doubles([invert_pose(box.world_from_box)[:3] for box in active.removals])
        self._removal_sizes = floats([box.size_m for box in active.removals])

    def struct(self, rays: Rays) -> tuple[ActiveActorsStruct, list[Any], int]:
        """The structure for these flat rays, what it points to beside this object's arrays, and how many
        actors were culled."""
        candidates = [boxes.bounds.in_reach(rays) for boxes in self.actor_sets]
        pairs = [boxes.struct(some) for boxes, some in zip(self.actor_sets, candidates, strict=True)]
        actor_sets = (ActorSetStruct * len(pairs))(*(pair[0] for pair in pairs))
        kept: list[Any] = [actor_sets, *(pair[1] for pair in pairs)]
        copies = None
        if self.copies is not None:
            copy, numbers = self.copies.struct(range(self.copies.count))
            copies = ctypes.pointer(copy)
            kept += [copy, numbers]
        skipped = sum(boxes.count for boxes in self.actor_sets) - sum(map(len, candidates))
        struct = ActiveActorsStruct(
            actor_sets, len(pairs), copies, address(self._sources), len(self._removals), address(self._removals),
            address(self._removal_sizes),
        )  # fmt: skip
        return struct, kept, skipped
