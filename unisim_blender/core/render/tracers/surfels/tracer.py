"""Rays traced through a drive of surfels: a `tracer.Tracer` that needs no trained scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ....errors import SceneError
from ....geometry import BoolArray, FloatArray, Trajectory, invert_pose, points_in_box, transform_points
from ....meshes.hits import MeshHits
from ....sensors.frames import RenderStats
from ....sensors.rays import Rays
from ....world.drive import Actor, Box, Drive
from ....world.replay import WorldState, parked_boxes
from ...quality import QUALITIES, Quality
from ...tracer import NEAR_M, Array, Maps, TraceResult, active_actors
from .cloud import BOX_MARGINS_M
from .colours import dome_cell, dome_colours
from .model import SurfelScene, SurfelSet
from .placed import NO_OWNER, PlacedSurfels, SurfelHits

CHUNK_RAYS = 1 << 18
"""Number of rays traced at a time: between two chunks Python can be interrupted."""
TIME_ROUNDING_S = 1e-3
"""Margin, seconds, of times of colours, which are float32."""
AT_ORIGIN = Trajectory(np.zeros(1), np.zeros((1, 3)), np.array([[1.0, 0, 0, 0]]))


class SurfelBackend:
    """Surfels of a recorded drive, loaded once: a `tracer.Backend`. ``recorded`` is the drive that
    they were made of."""

    sees_all = False

    def __init__(self, scene: SurfelScene, recorded: Drive, quality: Quality = QUALITIES["balanced"]) -> None:
        self.scene, self.recorded, self.quality = scene, recorded, quality
        self.parked: Mapping[str, Box] = parked_boxes(recorded)
        self._overhang_m: dict[tuple[str, tuple[float, float, float]], float] = {}
        self._world: tuple[object, SurfelSet, list[SurfelSet]] | None = None

    def bind(self, state: WorldState) -> SurfelTracer:
        """See `tracer.Backend`. Raises `SceneError` for actors that the log does not hold."""
        return SurfelTracer(self, state)

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        """See `tracer.Backend`: where the camera's recorded exposure does not change."""
        return self.scene.exposures.is_constant(sensor_id, start_s - TIME_ROUNDING_S, end_s + TIME_ROUNDING_S)

    def overhang_m(self, actor: Actor) -> float:
        """See `tracer.Backend`: how far its surfels reach."""
        name, scale = actor.appearance.actor, actor.scale
        if actor.appearance.mesh or name not in self.scene.actors:
            return 0.0
        if (name, scale) not in self._overhang_m:
            vertices = np.abs(self.scene.actors[name].vertices).max(0, initial=0.0)
            self._overhang_m[name, scale] = max(float((vertices * scale - actor.size_m / 2).max()), 0.0)
        return self._overhang_m[name, scale]

    def static_world(self, state: WorldState) -> tuple[SurfelSet, list[SurfelSet]]:
        """Return the static surfels, without those in removed boxes, and those of each static copy. The result for the
        last state is cached: sorting faces takes seconds."""
        key = replace(state, start_s=0.0, end_s=0.0, world_from_ego=AT_ORIGIN, actors=()).digest
        if self._world is None or self._world[0] != key:
            static, centres = self.scene.static, self.scene.static.centres
            edited = state.removed_boxes or state.static_copies
            upright = self.scene.upright if edited else np.zeros(0, bool)
            gone = np.zeros(len(static), bool)
            for box in state.removed_boxes:
                gone |= upright & points_in_box(centres, box.world_from_box, box.size_m + 2 * BOX_MARGINS_M)
            copies = [self._copied(upright, centres, copy.source) for copy in state.static_copies]
            self._world = key, static.without(gone), copies
        return self._world[1], self._world[2]

    def _copied(self, upright: BoolArray, centres: FloatArray, box: Box) -> SurfelSet:
        """Return the static surfels above the ground in a box, in the box's axes."""
        part = self.scene.static.of(upright & points_in_box(centres, box.world_from_box, box.size_m))
        inward = invert_pose(box.world_from_box)
        vertices = transform_points(inward, part.vertices.astype(np.float64)).astype(np.float32)
        normals = (part.normals @ inward[:3, :3].T).astype(np.float32)
        return SurfelSet(vertices, normals, part.intensity, part.colours, part.seen, part.painted)


class SurfelTracer:
    """A `tracer.Tracer`: a backend's surfels in a state of the world."""

    upsample = 1
    reach = 0
    trained_width: int | None = 0

    def __init__(self, backend: SurfelBackend, state: WorldState) -> None:
        for actor in state.actors:
            if actor.appearance.scene:
                raise SceneError(
                    f"actor {actor.uid!r} comes from another scene, {actor.appearance.scene}: without a trained scene a log's "
                    "own actors alone can be rendered, and meshes"
                )
        self.scene, self.quality = backend.scene, backend.quality
        self.active = active_actors(state, {"": tuple(self.scene.actors)})
        static, copies = backend.static_world(state)
        own = [(actor, self.scene.actors[actor.appearance.actor]) for actor in self.active.own.actors]
        self.surfels = PlacedSurfels(static, [*own, *zip(self.active.targets, copies, strict=True)])

    def trace(
        self, rays: Rays, passes: set[str], sky: bool, mesh_hits: MeshHits | None, stats: RenderStats
    ) -> TraceResult[Array]:
        """See `tracer.Tracer`. A camera's feature is the colour without exposure, and the time, on which the exposure
        depends; a LiDAR's is intensity and the probability of a return."""
        flat = rays.flat().sound()
        n = len(flat.time_s)
        stats.rays += n
        stats.samples_spent += n
        pixel_rad = _pixel_rad(rays)
        parts = []
        for begin in range(0, max(n, 1), CHUNK_RAYS):
            part = slice(begin, begin + CHUNK_RAYS)
            parts.append(self._part(flat.part(part), passes, sky, pixel_rad))
        feature = np.concatenate([part[0] for part in parts])
        depth = np.concatenate([part[1] for part in parts])
        maps = {name: np.concatenate([part[2][name] for part in parts]) for name in parts[0][2]}
        traced = TraceResult(
            feature, np.where(np.isfinite(depth), depth, 0.0), np.isfinite(depth).astype(np.float32), {}
        )
        traced.maps = {name: maps[name] for name in maps if name in passes}
        if mesh_hits is not None:
            traced.without_foreign = feature
            traced.mesh_opacity = self._with_meshes(traced.maps, depth, mesh_hits)
        return traced

    def image(
        self, traced: TraceResult[Array], directions: FloatArray, camera_id: str, shape: tuple[int, ...]
    ) -> Array:
        gain = self.scene.exposures.at(camera_id, traced.feature[:, 3])
        return np.asarray(np.clip(traced.feature[:, :3] * gain, 0, 1).reshape(*shape, 3), np.float32)

    def returns(self, traced: TraceResult[Array], directions: FloatArray) -> tuple[Array, Array]:
        return traced.feature[:, 0], traced.feature[:, 1]

    def heights(self, points: FloatArray) -> FloatArray:
        return np.asarray(points[:, 2] - self.scene.ground.at(points))

    def _part(self, rays: Rays, passes: set[str], sky: bool, pixel_rad: float) -> tuple[Array, Array, Maps]:
        hits = self.surfels.first(rays, NEAR_M)
        hit = hits.owner != NO_OWNER
        needs_normal = "normal" in passes or not sky
        normals = self.surfels.normals(hits, rays) if needs_normal else None
        if sky:
            colours, unsupported = self.colours(rays, hits, pixel_rad)
            feature = np.concatenate([colours, rays.time_s[:, None].astype(np.float32)], -1)
        else:
            feature, unsupported = self._beams(rays, hits, normals), ~hit
        own = len(self.active.own.actors)
        maps: Maps = {
            "depth": hits.t.astype(np.float32),
            "instance": np.where((hits.owner >= 0) & (hits.owner < own), hits.owner + 1, 0).astype(np.int32),
            "opacity": hit.astype(np.float32),
            "unsupported": unsupported,
        }
        if normals is not None:
            maps["normal"] = normals.astype(np.float32)
        return feature, hits.t.astype(np.float32), maps

    def colours(self, rays: Rays, hits: SurfelHits, pixel_rad: float) -> tuple[Array, BoolArray]:
        """Return colours (N, 3) in 0..1 of flat rays ``pixel_rad`` apart, radians, with ``hits``, and where (N,) they
        are from nothing recorded."""
        hit = hits.owner != NO_OWNER
        colours = self.surfels.colours(hits)
        dome = self.scene.dome
        colours[~hit] = dome_colours(dome, rays.directions[~hit])
        known = self.surfels.gathered(hits, "seen", (), np.bool_) & self.surfels.gathered(hits, "painted", (), np.bool_)
        known[~hit] = self.scene.dome_seen.reshape(-1)[dome_cell(rays.directions[~hit], dome.shape)]
        return colours, ~known

    def _beams(self, rays: Rays, hits: SurfelHits, normals: FloatArray | None) -> Array:
        assert normals is not None
        hit = hits.owner != NO_OWNER
        intensity = self.surfels.gathered(hits, "intensity", (), np.float64)
        cosine = np.abs(np.einsum("ni,ni->n", normals, rays.directions))
        returned = self.scene.drops.probability(np.where(hit, hits.t, 0.0), cosine, intensity)
        return np.stack([intensity, np.where(hit, returned, 0.0)], -1).astype(np.float32)

    def _with_meshes(self, maps: Maps, depth: Array, mesh_hits: MeshHits) -> NDArray[np.float32]:
        """Return the opacity (N,) of meshes: the share that they cover of rays that hit nothing before. The passes show
        them where that is the larger part."""
        stopped = np.zeros(len(depth), np.float32)
        front = mesh_hits.t < depth[mesh_hits.ray]
        stopped[mesh_hits.ray[front]] = mesh_hits.share[front]
        shown = front & (mesh_hits.share > 0.5)
        first = len(self.active.uids) - len(self.active.mesh_actors.uids)
        values = {
            "depth": mesh_hits.t,
            "normal": mesh_hits.normals,
            "instance": first + mesh_hits.actor + 1,
            "opacity": np.ones(len(mesh_hits.ray)),
            "unsupported": np.zeros(len(mesh_hits.ray), bool),
        }
        for name, array in maps.items():
            array[mesh_hits.ray[shown]] = values[name][shown]
        return stopped


def _pixel_rad(rays: Rays) -> float:
    """Return the largest angle, radians, between neighbours in a row of rays (h, w); 0, the finest, for other
    shapes."""
    if rays.time_s.ndim < 2 or rays.time_s.shape[1] < 2:
        return 0.0
    return float(np.linalg.norm(np.diff(rays.directions, axis=1), axis=-1).max())
