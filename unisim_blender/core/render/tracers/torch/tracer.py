"""The tracer in torch: the reference, the tracer that training renders with, and the one of every device but the CPU.

trace                      samples, fields, depth order, features  trace.py, segments.py
ray_passes                 depth, normal, instance, unsupported    ray_passes.py
ray_head, camera_decoder   features to pixels                      decode.py
lidar_head                 features to intensity and returns       decode.py

Rays are taken in chunks, as large as the device's memory allows.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from ....geometry import FloatArray
from ....meshes.hits import MeshHits
from ....model.checkpoint import TorchScene
from ....model.fields import VolumeFrame
from ....model.networks import shallow
from ....model.scene import SceneModel
from ....ops.devices import tensor_to
from ....ops.ray_segments import ActorSegments, MeshSegments, RayBatch
from ....ops.segment_trace import SegmentTrace
from ....sensors.bounds import Bounds
from ....sensors.frames import RenderStats
from ....sensors.rays import Rays, sound_directions
from ....world.drive import Actor, Box
from ....world.replay import WorldState
from ...confidence import RecordedDepth
from ...observed_space import Observed, ObservedSpace
from ...quality import QUALITIES, Quality
from ...recorded_depth import recorded_depth
from ...tracer import FOREIGN_EDGE_CELLS, NEAR_M, UNIFORM_STEP_M, Array, TraceResult, active_actors
from .actor_tensors import active_actor_tensors
from .ray_passes import ray_passes
from .segments import Sampling
from .trace import trace

MIN_CHUNK_RAYS = 1 << 12
"""Smallest number of rays of a chunk: a device without memory for these has none for the scene."""


def in_chunks(count: int, rays: int, take: Callable[[int, int], None]) -> None:
    """Call ``take`` with the first and the end of each chunk of ``count`` rays, of ``rays`` at most; once where there are none.

    Where the device has no memory for a chunk, it and those that follow are halved. Raises torch.cuda.OutOfMemoryError
    where there is none for `MIN_CHUNK_RAYS`. ``take`` must store its result last.
    """
    begin = 0
    while begin < count or begin == 0:
        try:
            take(begin, min(begin + rays, count))
        except torch.cuda.OutOfMemoryError:
            if rays <= MIN_CHUNK_RAYS:
                raise
            rays //= 2
        else:
            begin += rays
            continue
        # here no frame of the failed attempt holds its tensors any more
        torch.cuda.empty_cache()


CHUNK_RAYS = 1 << 14
MAX_GPU_CHUNK_RAYS = 1 << 17
"""Largest number of rays of a chunk on a GPU: Python's overhead is per chunk."""
EXACT_SAMPLES = QUALITIES["reference"].samples
"""Number of samples of qualities that others are compared with."""


class TorchBackend:
    """Trained scenes on a device, loaded once: a `tracer.Backend`. ``others`` are scenes by path, for actors that
    come from them."""

    sees_all = False

    def __init__(
        self,
        scene: TorchScene,
        quality: Quality = QUALITIES["balanced"],
        others: Mapping[str, TorchScene] | None = None,
    ) -> None:
        self.scene, self.device, self.quality = scene, scene.actor_tables.device, quality
        self.scenes = {path: (s.model, s.actor_tables) for path, s in {"": scene, **(others or {})}.items()}
        self.appearances = {
            path: None if m.config.actors == "none" else tuple(m.actor_ids) for path, (m, _) in self.scenes.items()
        }
        self.parked: Mapping[str, Box] = scene.header.parked
        self.recorded_actors: Mapping[str, Actor] | None = scene.header.drive.actors
        """Actors as they were recorded, by their ids: they have the recorded ground in their boxes."""
        self.exposures = scene.header.exposures
        self.space: ObservedSpace | None = None
        self.clipped = False

    @property
    def observed(self) -> Observed:
        model = self.scene.model
        return self.scene.header, model.observed.cpu().numpy(), model.config.voxel_m

    def recorded_depth(self) -> RecordedDepth:
        """Return what confidence is computed from."""
        return recorded_depth(self, self.scene.header)

    def within(self, space: ObservedSpace, clip: bool) -> TorchBackend:
        other = copy.copy(self)
        other.space, other.clipped = space, clip
        if clip:
            model, occupancy = shallow(self.scene.model), shallow(self.scene.model.occupancy)
            values = torch.where(self.scene.model.observed > 0, occupancy.values, 0)
            occupancy._buffers = {**occupancy._buffers, "values": values}
            model._modules["occupancy"] = occupancy
            other.scene = replace(self.scene, model=model)
        return other

    def bind(self, state: WorldState) -> TorchTracer:
        return TorchTracer(self, state)

    def is_steady(self, sensor_id: str, start_s: float, end_s: float) -> bool:
        """See `tracer.Backend`: never, since last bits of torch's products depend on how many rays are traced at
        once."""
        return False

    def overhang_m(self, actor: Actor) -> float:
        """See `tracer.Backend`: fields end at their boxes."""
        return 0.0


class TorchTracer:
    """A `tracer.Tracer` on the scene's device: a backend's scenes in a state of the world."""

    def __init__(self, backend: TorchBackend, state: WorldState) -> None:
        scene = backend.scene
        self.scene, self.device, self.quality = scene, backend.device, backend.quality
        self.space, self.clipped = backend.space, backend.clipped
        self.active = active_actors(state, backend.appearances)
        self.tensors = active_actor_tensors(self.active, backend.scenes, self.device)
        self.bounds = Bounds(self.active.own.actors)
        self.upsample, self.trained_width = scene.model.config.upsample, scene.header.training.get("width")
        models = [scene.model, *(actor_set.scene for actor_set in self.tensors.foreign.values())]
        # decoders that look aside see past a foreign actor's edges
        alone = all(model.camera_decoder.reach == 0 and model.config.upsample == 1 for model in models)
        self.edge = 0 if alone else FOREIGN_EDGE_CELLS
        self.reach = scene.model.camera_decoder.reach + (self.edge if self.active.foreign else 0)

    @property
    def half(self) -> bool:
        """Whether decoders use half precision, which suffices for a pixel's 8 bits, where a device is faster with it.
        The quality may change from one image to the next."""
        return torch.device(self.device).type == "cuda" and self.quality.samples < EXACT_SAMPLES

    @torch.no_grad()
    def trace(
        self, rays: Rays, passes: set[str], sky: bool, mesh_hits: MeshHits | None, stats: RenderStats
    ) -> TraceResult[Tensor]:
        """See `tracer.Tracer`: rays are traced in chunks, and their results joined."""
        rays = rays.flat().sound()
        batch = to_batch(rays, self.scene.model.frame)
        starts = None
        if self.space is not None and self.clipped:
            starts = torch.as_tensor(self.space.starts(rays)).to(batch.origins)
        adds_unsupported, requested = self.space is not None and "unsupported" in passes, passes
        passes = passes - {"unsupported"} | {"depth", "instance"} if adds_unsupported else passes
        near = self.bounds.in_reach(rays)
        stats.actors_skipped += len(self.active.own.actors) - len(near)
        among = torch.tensor(near, dtype=torch.long, device=self.device)
        sampling = Sampling(fine=self.quality.samples, background_fine=self.quality.background, sky=sky)
        pieces, maps = [], []

        def take(begin: int, end: int) -> None:
            part = RayBatch(*(x[begin:end] for x in (batch.origins, batch.directions, batch.time_s)))
            if starts is not None:
                part = replace(part, starts=starts[begin:end])
            surfaces = None if mesh_hits is None else mesh_hits.between(begin, end)
            traced = trace(self.scene.model, self.tensors, part, sampling, among, surfaces)
            pass_maps = ray_passes(self.scene, self.tensors, part, traced, passes)
            self._count(part, traced, stats)
            maps.append(pass_maps)
            # samples of all chunks together would be too many to keep
            pieces.append(replace(traced, ray_segments=(), weights=(), background=None))

        in_chunks(len(batch), MAX_GPU_CHUNK_RAYS if batch.origins.is_cuda else CHUNK_RAYS, take)
        covered = _joined([p.mesh_opacity for p in pieces])
        joined = {name: np.concatenate([m[name] for m in maps]) for name in maps[0]}
        if adds_unsupported:
            assert self.space is not None
            joined["unsupported"] = ~self.space.supported(rays, joined["depth"], joined["instance"], self.clipped)
            joined = {name: x for name, x in joined.items() if name in requested}
        return TraceResult(
            feature=torch.cat([p.feature for p in pieces]),
            depth_m=torch.cat([p.depth_m for p in pieces]),
            opacity=torch.cat([p.opacity for p in pieces]),
            maps=joined,
            foreign_features=[torch.cat(parts) for parts in zip(*(p.foreign_features for p in pieces), strict=True)],
            foreign_opacity=[torch.cat(parts) for parts in zip(*(p.foreign_opacity for p in pieces), strict=True)],
            without_foreign=_joined([p.without_foreign for p in pieces]),
            mesh_opacity=None if covered is None else covered.cpu().numpy(),
        )

    def _count(self, part: RayBatch, traced: SegmentTrace, stats: RenderStats) -> None:
        frame = self.scene.model.frame
        near, far = frame.span(frame.points(part.origins), frame.vectors(part.directions), NEAR_M)
        uniform = int(((far - near) / UNIFORM_STEP_M).ceil().sum())
        config = self.scene.model.config.samples
        # what places a sample costs a distance query too
        spent = traced.samples + sum(
            len(s) * (config.actor_proposals if isinstance(s, ActorSegments) else config.static_proposals)
            for s in traced.ray_segments
            if not isinstance(s, MeshSegments)
        )
        stats.rays += len(part)
        stats.samples_spent += spent
        stats.samples_saved += max(0, uniform - spent)

    @torch.no_grad()
    def image(
        self, traced: TraceResult[Tensor], directions: FloatArray, camera_id: str, shape: tuple[int, ...]
    ) -> Array:
        along = torch.as_tensor(sound_directions(directions), dtype=torch.float32, device=self.device)

        def decoded(network: SceneModel, feature: Tensor) -> Tensor:
            code = network.camera_ids.get(camera_id, -1)
            number = torch.full((len(feature),), code, dtype=torch.long, device=self.device)
            with torch.autocast(torch.device(self.device).type, torch.float16) if self.half else nullcontext():
                features = network.ray_head(feature, along, number)
                # channels come last in memory, as they did in a row of features
                image: Tensor = network.camera_decoder(features.view(1, *shape, -1).permute(0, 3, 1, 2))
            return image.float()

        rgb = decoded(self.scene.model, traced.feature if traced.without_foreign is None else traced.without_foreign)
        for i, actor_set in enumerate(self.tensors.foreign.values()):
            # each scene's features are its own decoder's: the images are laid over each other, not the features
            share = traced.foreign_opacity[i].clamp(0, 1)
            other = decoded(actor_set.scene, _extrapolated(traced.foreign_features[i], share, shape, self.edge))
            alpha = F.interpolate(share.view(1, 1, *shape), size=rgb.shape[-2:], mode="bilinear", align_corners=False)
            if other.shape != rgb.shape:
                other = F.interpolate(other, size=rgb.shape[-2:], mode="bilinear", align_corners=False)
            rgb = torch.lerp(rgb, other, alpha)
        return rgb[0].permute(1, 2, 0).cpu().numpy().astype(np.float32)

    @torch.no_grad()
    def returns(self, traced: TraceResult[Tensor], directions: FloatArray) -> tuple[Array, Array]:
        along = torch.as_tensor(sound_directions(directions), dtype=torch.float32, device=self.device)
        intensity, logit = self.scene.model.lidar_head(traced.feature, along, traced.depth_m, traced.opacity)
        for i, actor_set in enumerate(self.tensors.foreign.values()):
            share = traced.foreign_opacity[i].clamp(0, 1)
            own = traced.foreign_features[i] / share.clamp_min(1e-3)[:, None]
            i_foreign, l_foreign = actor_set.scene.lidar_head(own, along, traced.depth_m, traced.opacity)
            intensity, logit = torch.lerp(intensity, i_foreign, share), torch.lerp(logit, l_foreign, share)
        # what hits nothing returns nothing
        probability = torch.sigmoid(logit) * (traced.opacity > 0.5)
        return intensity.cpu().numpy(), probability.cpu().numpy()

    @torch.no_grad()
    def heights(self, points: FloatArray) -> FloatArray:
        local = self.scene.model.frame.points(self.scene.model.frame.recentred(points))
        return np.asarray((local[:, 2] - self.scene.model.ground.height(local)).cpu().numpy(), np.float64)


def to_batch(rays: Rays, frame: VolumeFrame) -> RayBatch:
    """Return flat rays (N,) as tensors on a volume's device, measured from its corner."""
    return RayBatch(
        frame.recentred(rays.origins).contiguous(),
        torch.as_tensor(rays.directions).to(frame.rotation.dtype).to(frame.rotation.device).contiguous(),
        tensor_to(torch.as_tensor(rays.time_s, dtype=torch.float64), frame.rotation.device).contiguous(),
    )


def _joined(parts: list[Tensor | None]) -> Tensor | None:
    there = [part for part in parts if part is not None]
    return torch.cat(there) if there else None


def _extrapolated(feature: Tensor, opacity: Tensor, shape: tuple[int, ...], cells: int) -> Tensor:
    """Return a foreign actor's features (N, F), divided by its opacity and extended by ``cells`` past its edges, which
    decoders read, too."""
    f = feature.view(1, *shape, -1).permute(0, 3, 1, 2)
    a = opacity.view(1, 1, *shape)
    for _ in range(cells):
        blurred_f, blurred_a = F.avg_pool2d(f, 3, 1, 1), F.avg_pool2d(a, 3, 1, 1)
        empty = a < 1e-3
        f, a = torch.where(empty, blurred_f, f), torch.where(empty, blurred_a, a)
    return (f / a.clamp_min(1e-3)).permute(0, 2, 3, 1).reshape(-1, f.shape[1])
