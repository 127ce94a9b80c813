"""Who is on, as the kernels read it: boxes on their ways, copied and removed boxes of space."""

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
from ...actor_sets import Cast
from .scene import CompiledScene
from .structs import CastStruct, TroupeStruct, address, doubles, floats


class _Ways:
    """Boxes with looks of one scene."""

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
            "sizes": floats(np.array([a.look_size_m for a in actors]).reshape(-1, 3)),
            "start": doubles([a.start_s for a in actors]),
            "end": doubles([a.end_s for a in actors]),
            "rows": np.array(rows, np.int32),
            "scales": floats(np.array([a.scale for a in actors]).reshape(-1, 3)),
        }

    def struct(self, among: Sequence[int]) -> tuple[TroupeStruct, Any]:
        """The structure for rays that can meet these boxes alone, and what it points to beside this object's arrays."""
        candidates = np.array(among, np.int32)
        scene = ctypes.pointer(self.scene.struct)
        pointers = {name: address(array) for name, array in self.arrays.items()}
        return TroupeStruct(
            scene, self.count, self.keys, **pointers, among=address(candidates), candidates=len(among)
        ), candidates


class CompiledCast:
    """A drive's cast with looks of ``scene`` and of ``others`` by their paths."""

    def __init__(self, cast: Cast, scene: CompiledScene, others: dict[str, CompiledScene]) -> None:
        scenes = [scene, *(others[path] for path in cast.guests)]
        self.troupes = [
            _Ways(own, troupe.actors, troupe.rows) for own, troupe in zip(scenes, (cast.own, *cast.guests.values()), strict=True)
        ]
        self.copies = _Ways(scene, cast.targets, [0] * len(cast.targets)) if cast.targets else None
        self._sources = doubles([box.world_from_box[:3] for box in cast.sources])
        self._removals = doubles([invert_pose(box.world_from_box)[:3] for box in cast.removals])
        self._removal_sizes = floats([box.size_m for box in cast.removals])

    def struct(self, rays: Rays) -> tuple[CastStruct, list[Any], int]:
        """The structure for these flat rays, what it points to beside this object's arrays, and how many actors they miss."""
        among = [ways.bounds.in_reach(rays) for ways in self.troupes]
        pairs = [ways.struct(some) for ways, some in zip(self.troupes, among, strict=True)]
        troupes = (TroupeStruct * len(pairs))(*(pair[0] for pair in pairs))
        kept: list[Any] = [troupes, *(pair[1] for pair in pairs)]
        copies = None
        if self.copies is not None:
            copy, candidates = self.copies.struct(range(self.copies.count))
            copies = ctypes.pointer(copy)
            kept += [copy, candidates]
        skipped = sum(ways.count for ways in self.troupes) - sum(map(len, among))
        struct = CastStruct(
            troupes, len(pairs), copies, address(self._sources), len(self._removals), address(self._removals),
            address(self._removal_sizes),
        )  # fmt: skip
        return struct, kept, skipped
