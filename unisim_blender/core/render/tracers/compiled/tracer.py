"""Rays traced with numpy and the compiled kernels: `tracer.Tracer` without torch, whose `TorchTracer` is
the specification.

Actors go to the kernels as boxes on their trajectories, with copied and removed boxes of space.
"""

from __future__ import annotations

import copy
import ctypes
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .... import native
from ....geometry import FloatArray, invert_pose
from ....meshes.hits import MeshHits
from ....ops.constants import COVERED_TRANSMITTANCE, OPAQUE_TRANSMITTANCE
from ....sensors.bounds import Bounds
from ....sensors.frames import RenderStats
from ....sensors.rays import Rays, sound_directions
from ....world.drive import Actor, Box
from ....world.replay import PaddedKeys, WorldState
from ...confidence import RecordedDepth
from ...observed_space import Observed, ObservedSpace
from ...quality import QUALITIES, Quality
from ...recorded_depth import recorded_depth
from ...tracer import (
    FOREIGN_EDGE_CELLS,
    NEAR_M,
    UNIFORM_STEP_M,
    ActiveActors,
    Array,
    Maps,
    TraceResult,
    active_actors,
    tiled,
)
from .decoder import extended_over_edges, resized, sigmoid
from .scene import CompiledScene
from .structs import (
    ActiveActorsStruct,
    ActorSetStruct,
    MeshHitsStruct,
    RaysStruct,
    SamplingStruct,
    TraceResultStruct,
    address,
    doubles,
    floats,
)


class _BoxTrajectories:
    """Trajectories of boxes whose appearances come from one scene."""

    def __init__(self, scene: CompiledScene, actors: Sequence[Actor], rows: Sequence[int]) -> None:
        """``rows``: the actors' appearances; none for boxes of static space."""
        self.scene, self.count = scene, len(actors)
        gaits, rows = scene.gaits, list(rows)
        keys = PaddedKeys.of(actors)
        self.bounds = Bounds(actors, keys)
        self.keys = keys.times_s.shape[1]
        scales = floats(np.array([a.scale for a in actors]).reshape(-1, 3))
        self.arrays: dict[str, NDArray[Any]] = {
            "times": keys.times_s,
            "lengths": keys.lengths,
            "positions": keys.positions,
            "quaternions": keys.quaternions_wxyz,
            "sizes": floats(np.array([a.appearance_size_m for a in actors]).reshape(-1, 3)),
            "start": doubles([a.start_s for a in actors]),
            "end": doubles([a.end_s for a in actors]),
            "rows": np.ascontiguousarray(gaits.first[rows]) if rows else np.zeros(self.count, np.int32),
            "walked": keys.walked_m,
            "cycles": gaits.cycles_m[rows] * scales[:, 0] if rows else np.zeros(self.count),
            "scales": scales,
        }

    def struct(self, candidates: Sequence[int]) -> tuple[ActorSetStruct, Any]:
        """Return the structure for rays that can hit only these boxes, and the array that it points to beside this
        object's."""
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
        self.copies = _BoxTrajectories(scene, active.targets, ()) if active.targets else None
        self._sources = doubles([box.world_from_box[:3] for box in active.sources])
        self._removals = doubles([invert_pose(box.world_from_box)[:3] for box in active.removals])
        self._removal_sizes = floats([box.size_m for box in active.removals])

    @property
    def arrays(self) -> list[NDArray[Any]]:
        """The arrays that `struct` points to, but for those that it returns."""
        boxes = [*self.actor_sets, *([] if self.copies is None else [self.copies])]
        of_boxes = [array for each in boxes for array in each.arrays.values()]
        return [*of_boxes, self._sources, self._removals, self._removal_sizes]

    def struct(self, rays: Rays, slack_rad: float = 0.0) -> tuple[ActiveActorsStruct, list[Any], int]:
        """Return the structure for these flat rays, and those within ``slack_rad`` of them, the arrays that it points to
        beside this object's, and the number of culled actors."""
        candidates = [boxes.bounds.in_reach(rays, slack_rad) for boxes in self.actor_sets]
        pairs = [boxes.struct(some) for boxes, some in zip(self.actor_sets, candidates, strict=True)]
        actor_sets = (ActorSetStruct * len(pairs))(*(pair[0] for pair in pairs))
        referenced: list[Any] = [actor_sets, *(pair[1] for pair in pairs)]
        copies = None
        if self.copies is not None:
            copy, numbers = self.copies.struct(range(self.copies.count))
            copies = ctypes.pointer(copy)
            referenced += [copy, numbers]
        skipped = sum(boxes.count for boxes in self.actor_sets) - sum(map(len, candidates))
        struct = ActiveActorsStruct(
            actor_sets, len(pairs), copies, address(self._sources), len(self._removals), address(self._removals),
            address(self._removal_sizes),
        )  # fmt: skip
        return struct, referenced, skipped


CHUNK_RAYS = 1 << 18
"""Rays per call of the kernel: between two calls Python can be interrupted."""
STATS_RAY_STRIDE = 16
"""Stride through the rays by which the number of saved samples is estimated."""
STEP_GROWTH_PER_M = 0.02
"""Relative growth of the march's longest step per metre of distance: distant things are small in the image."""
MIN_SLOPE = 0.2
"""Smallest slope of the signed distance behind a surface, per metre, that the march assumes."""
MIN_STEP_M = 0.01
MIN_SPLIT_WEIGHT = 0.2
"""Smallest weight of an interval that is halved."""


class CompiledBackend:
    """Trained scenes as the kernels read them, loaded once: a `tracer.Backend`. ``others`` are scenes by path, for
    actors that come from them."""

    sees_all = False

    def __init__(
        self,
        scene: CompiledScene,
        quality: Quality = QUALITIES["balanced"],
        others: Mapping[str, CompiledScene] | None = None,
    ) -> None:
        self.scene, self.others = scene, dict(others or {})
        self.quality = quality
        self.parked: Mapping[str, Box] = scene.header.parked
        self.recorded_actors: Mapping[str, Actor] | None = scene.header.drive.actors
        """Actors as they were recorded, by their ids: they have the recorded ground in their boxes."""
        self.exposures = scene.header.exposures
        self.space: ObservedSpace | None = None
        self.clipped = False

    @property
    def observed(self) -> Observed:
        return self.scene.header, self.scene.observed, self.scene.config.voxel_m

    def recorded_depth(self) -> RecordedDepth:
        """Return what confidence is computed from."""
        return recorded_depth(self, self.scene.header)

    def within(self, space: ObservedSpace, clip: bool) -> CompiledBackend:
        other = copy.copy(self)
        other.space, other.clipped = space, clip
        return other

    def bind(self, state: WorldState) -> CompiledTracer:
        return CompiledTracer(self, state)

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        """See `tracer.Backend`: always."""
        return True

    def overhang_m(self, actor: Actor) -> float:
        """See `tracer.Backend`: fields end at their boxes."""
        return 0.0


class CompiledTracer:
    """A `tracer.Tracer`: a backend's scenes in a state of the world."""

    def __init__(self, backend: CompiledBackend, state: WorldState) -> None:
        scene, others = backend.scene, backend.others
        self.scene, self.quality = scene, backend.quality
        self.space, self.clipped = backend.space, backend.clipped
        self.active = active_actors(
            state, {"": scene.appearances, **{path: other.appearances for path, other in others.items()}}
        )
        self._foreign = [others[path] for path in self.active.foreign]
        self._compiled_actors = CompiledActors(self.active, scene, others)
        self.upsample, self.trained_width = scene.config.upsample, scene.header.training.get("width")
        # decoders that use neighbouring cells look past a foreign actor's edges
        alone = all(s.decoder.reach == 0 and s.config.upsample == 1 for s in (scene, *self._foreign))
        self._edge = 0 if alone else FOREIGN_EDGE_CELLS
        self.reach = scene.decoder.reach + (self._edge if self._foreign else 0)

    def trace(
        self, rays: Rays, passes: set[str], sky: bool, mesh_hits: MeshHits | None, stats: RenderStats
    ) -> TraceResult[Array]:
        order = tiled(rays.time_s.shape)
        # a list keeps its own order, and its parts need no copies
        listed, flat = rays.time_s.ndim < 2, rays.flat().sound()
        rays = Rays(doubles(flat.origins), doubles(flat.directions), doubles(flat.time_s))
        n, features = len(rays.time_s), self.scene.config.features
        traced = TraceResult(np.empty((n, features), np.float32), np.empty(n, np.float32), np.empty(n, np.float32), {})
        traced.foreign_features = [np.empty((n, foreign.config.features), np.float32) for foreign in self._foreign]
        traced.foreign_opacity = [np.empty(n, np.float32) for _ in self._foreign]
        if mesh_hits is not None or self._foreign:
            traced.without_foreign = np.empty_like(traced.feature)
        if mesh_hits is not None:
            traced.mesh_opacity = np.empty(n, np.float32)
        starts = self.space.starts(flat) if self.space is not None and self.clipped else None
        maps: Maps = {}
        if passes & {"depth", "unsupported"}:
            maps["depth"] = np.empty(n, np.float32)
        if passes & {"instance", "unsupported"}:
            maps["instance"] = np.empty(n, np.int32)
        if "normal" in passes:
            maps["normal"] = np.empty((n, 3), np.float32)
        for begin in range(0, n, CHUNK_RAYS):
            part = order[begin : begin + CHUNK_RAYS]
            at = slice(begin, begin + CHUNK_RAYS) if listed else part
            some = rays.part(at)
            self._run(rays, part, some, sky, mesh_hits, traced, maps, stats, starts)
        solid = traced.opacity > 0.5
        if "depth" in maps:
            maps["depth"][~solid] = np.inf
        if "opacity" in passes:
            maps["opacity"] = traced.opacity
        if self.space is not None and "unsupported" in passes:
            maps["unsupported"] = ~self.space.supported(flat, maps["depth"], maps["instance"], self.clipped)
        elif "unsupported" in passes:
            ends = rays.origins + rays.directions * np.nan_to_num(maps["depth"], posinf=1e6)[:, None].astype(np.float64)
            maps["unsupported"] = ~(self.scene.supported(ends) | (maps["instance"] > 0))
        traced.maps = {name: values for name, values in maps.items() if name in passes}
        return traced

    def _run(
        self,
        rays: Rays,
        order: NDArray[np.int64],
        some: Rays,
        sky: bool,
        mesh_hits: MeshHits | None,
        traced: TraceResult[Array],
        maps: Maps,
        stats: RenderStats,
        starts: Array | None = None,
    ) -> None:
        """Trace the rays of these numbers, which are ``some``, into the arrays of ``traced`` and ``maps``."""
        library = native.library()
        assert library is not None
        struct = RaysStruct(len(order), *map(address, (rays.origins, rays.directions, rays.time_s, order, starts)))
        active, _referenced, skipped = self._compiled_actors.struct(some)
        meshes = None if mesh_hits is None else MeshHitArrays(mesh_hits)
        samples = np.zeros(1, np.int64)
        foreign = len(self._foreign)
        out = TraceResultStruct(
            *map(address, (traced.feature, traced.depth_m, traced.opacity)),
            *(address(maps.get(name)) for name in ("depth", "instance", "normal")),
            address(traced.without_foreign),
            ctypes.addressof(features := (ctypes.c_void_p * foreign)(*map(address, traced.foreign_features))),
            ctypes.addressof(opacities := (ctypes.c_void_p * foreign)(*map(address, traced.foreign_opacity))),
            address(traced.mesh_opacity),
            address(samples),
        )
        scene = self.scene.observed_struct if self.clipped else self.scene.struct
        library.unisim_trace(
            ctypes.byref(scene), ctypes.byref(active), ctypes.byref(struct),
            None if meshes is None else ctypes.byref(meshes.struct), ctypes.byref(self._sampling(sky)),
            ctypes.byref(out),
            native.threads(),
        )  # fmt: skip
        del features, opacities
        stats.rays += len(order)
        stats.actors_skipped += skipped
        stats.samples_spent += int(samples[0])
        stats.samples_saved += max(0, self._uniform(some) - int(samples[0]))

    def _sampling(self, sky: bool) -> SamplingStruct:
        s, q = self.scene.config.samples, self.quality

        def count(n: int, times: float) -> int:
            return max(2, round(n * times))

        placed = (count(n, q.samples) for n in (s.static_proposals, s.static, s.actor_proposals, s.actor))
        background = (count(n, q.background) for n in (s.background_proposals, s.background))
        return SamplingStruct(
            *placed, *background, near_m=NEAR_M, opaque=q.opaque, background_opaque=max(OPAQUE_TRANSMITTANCE, 1.5 * q.opaque),
            background=1,
            sky=int(sky), stride_m=q.stride_m, step_growth_per_m=STEP_GROWTH_PER_M, relaxation=q.relaxation,
            min_slope=MIN_SLOPE,
            min_step_m=MIN_STEP_M, splits=q.splits, split_weight=MIN_SPLIT_WEIGHT,
        )  # fmt: skip

    def _uniform(self, rays: Rays) -> int:
        """Estimate how many samples even steps through the volume would take, from some of the rays."""
        rays = Rays(*(x[::STATS_RAY_STRIDE] for x in (rays.origins, rays.directions, rays.time_s)))
        o = self.scene.into_volume(rays.origins)
        d = self.scene.into_volume(rays.directions) - self.scene.into_volume(np.zeros((1, 3)))
        safe = np.where(np.abs(d) < 1e-9, 1e-9, d)
        a, b = -o / safe, (self.scene.volume.size_m - o) / safe
        near, far = np.minimum(a, b).max(1).clip(NEAR_M), np.maximum(a, b).min(1)
        return STATS_RAY_STRIDE * int(np.ceil(np.maximum(far - near, 0) / UNIFORM_STEP_M).sum())

    def image(
        self, traced: TraceResult[Array], directions: FloatArray, camera_id: str, shape: tuple[int, ...]
    ) -> Array:
        cells = sound_directions(directions).reshape(*shape, 3)

        def decoded(scene: CompiledScene, feature: Array) -> Array:
            return scene.decoder.image(feature.reshape(*shape, -1), cells, scene.camera_code(camera_id))

        rgb = decoded(self.scene, traced.feature if traced.without_foreign is None else traced.without_foreign)
        size = rgb.shape[0], rgb.shape[1]
        for i, foreign in enumerate(self._foreign):
            # each scene's decoder reads its own features only: the images are composited, not the features
            opacity = traced.foreign_opacity[i].clip(0, 1).reshape(*shape)
            feature = extended_over_edges(traced.foreign_features[i].reshape(*shape, -1), opacity, self._edge)
            other, alpha = decoded(foreign, feature), resized(opacity[..., None], size)
            rgb += alpha * (resized(other, size) - rgb)
        return rgb

    def returns(self, traced: TraceResult[Array], directions: FloatArray) -> tuple[Array, Array]:
        directions = sound_directions(directions)
        if traced.returned is not None:
            return traced.returned
        intensity, logit = self.scene.decoder.returns(traced.feature, directions, traced.depth_m, traced.opacity)
        for i, foreign in enumerate(self._foreign):
            covered = traced.foreign_opacity[i].clip(0, 1)
            own = traced.foreign_features[i] / covered.clip(1e-3)[:, None]
            theirs = foreign.decoder.returns(own, directions, traced.depth_m, traced.opacity)
            intensity, logit = (a + covered * (b - a) for a, b in zip((intensity, logit), theirs, strict=True))
        # rays that hit nothing return nothing
        return intensity, sigmoid(logit) * (traced.opacity > 0.5)

    def heights(self, points: FloatArray) -> FloatArray:
        return self.scene.height_above_ground(points)


class MeshHitArrays:
    """Intersections of rays and meshes, as the kernels read them."""

    def __init__(self, mesh_hits: MeshHits) -> None:
        share = np.minimum(mesh_hits.share, 1 - COVERED_TRANSMITTANCE)
        self.arrays: list[NDArray[Any]] = [
            np.ascontiguousarray(mesh_hits.ray, np.int64),
            *map(floats, (mesh_hits.t, -np.log1p(-share), mesh_hits.normals)),
            np.ascontiguousarray(mesh_hits.actor, np.int32),
        ]
        self.struct = MeshHitsStruct(len(mesh_hits.ray), *map(address, self.arrays))
