"""Tracing of rays through the scene: placing samples, querying fields, compositing in depth order.

Training and rendering share this path. Behind the volume, along rays that come through it, are the background model and
the sky.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from ....meshes.hits import MeshHits
from ....model.scene import SceneModel
from ....ops.composite import Composite, composite
from ....ops.constants import OPAQUE_TRANSMITTANCE
from ....ops.quantiles import stratified
from ....ops.ray_segments import ActorSegments, MeshSegments, RayBatch, RaySegments, rows_of
from ....ops.segment_trace import BackgroundTrace, SegmentTrace
from ....ops.transmittances import weights_from_tau
from ...tracer import NEAR_M
from .actor_tensors import ActiveActorTensors
from .places import background_places, disparity
from .segments import Sampling, StaticMask, actor_segments, along, copied_segments, mesh_segments, only, static_segments


class BackgroundSamples(NamedTuple):
    """Result of tracing rays: features (N, F) of the scene's own, mean depths in metres, opacities and transmittances
    (N,)."""

    feature: Tensor
    depth_m: Tensor
    opacity: Tensor
    transmittance_after: Tensor


@dataclass(frozen=True)
class Background:
    """The background model and the sky along rays (R,): places t, densities times lengths tau, weights (R, K) of what
    stops there, transmittance before each (R, K) and after all (R,), features (R, F)."""

    ray: Tensor
    t: Tensor
    tau: Tensor
    weight: Tensor
    transmittance_before: Tensor
    transmittance_after: Tensor
    feature: Tensor

    @property
    def samples(self) -> int:
        """Number of queries, with those of the sky."""
        return self.t.numel() + len(self.ray)

    def feature_behind(self, feature: Tensor, reach: Tensor) -> Tensor:
        """Return features (N, F) composited over the background; ``reach`` (N,) is the transmittance before it."""
        return feature.index_add(0, self.ray, reach[self.ray][:, None] * self.feature)

    def behind(self, traced: Composite) -> tuple[BackgroundSamples, BackgroundTrace]:
        """Return the result of the volume composited over the background, and the background's samples."""
        ray, reach = self.ray, traced.transmittance_after[self.ray]
        stopped = traced.depth_m * traced.opacity
        stopped = stopped.index_add(0, ray, reach * (self.weight * self.t).sum(1))
        trace = BackgroundTrace(ray, self.t, self.tau, reach[:, None] * self.transmittance_before)
        feature = traced.feature.index_add(0, ray, reach[:, None] * self.feature)
        after = traced.transmittance_after.index_put((ray,), reach * self.transmittance_after)
        opacity = 1 - after
        return BackgroundSamples(feature, stopped / opacity.clamp_min(1e-6), opacity, after), trace


def background_along(scene: SceneModel, rays: RayBatch, sampling: Sampling, reach: Tensor) -> Background | None:
    """Return the background behind the volume, along the rays whose transmittance ``reach`` (N,) is not negligible;
    None where there is none."""
    through, there = reach.detach() > OPAQUE_TRANSMITTANCE, None
    if sampling.padding is None:
        ray = torch.nonzero(through)[:, 0]
    else:
        ray, there = torch.arange(len(reach), device=reach.device), through
    if len(ray) == 0:
        return None
    o, d = scene.frame.points(rays.origins[ray]), scene.frame.vectors(rays.directions[ray])
    _, t_far = scene.frame.span(o, d, NEAR_M)
    t0 = t_far.clamp_min(NEAR_M)[:, None]
    samples = scene.config.samples
    u, within = (
        stratified(len(o), sampling.background_count(count), sampling.jitter, o, sampling.generator)
        for count in (samples.background_proposals, samples.background)
    )
    u, width = background_places(scene, o, d, t0, u, within)
    t = disparity(u, t0, scene.config.far_m)
    density, feature = scene.background(along(o, d, t).reshape(-1, 3))
    tau = only(there, density.view(u.shape) * width)
    before, after = weights_from_tau(tau)
    weight = before * -torch.expm1(-tau)
    directions = rays.directions[ray]
    feature = scene.directed(feature, directions.repeat_interleave(u.shape[1], 0)).view(*u.shape, -1)
    feature = (weight[..., None] * feature).sum(1)
    if sampling.sky:
        sky = scene.directed(scene.background.sky(d), directions)
        feature = feature + only(there, after[:, None]) * sky
    return Background(ray, t, tau, weight, before, after, feature)


def trace(
    scene: SceneModel,
    active: ActiveActorTensors,
    rays: RayBatch,
    sampling: Sampling,
    among: Tensor | None = None,
    mesh_hits: MeshHits | None = None,
) -> SegmentTrace:
    """Trace rays (N,): features, depths and opacities. ``among`` are the numbers of the own actors that rays can hit,
    others are skipped; ``mesh_hits`` are the rays' hits on meshes."""
    actors, first = [], 0
    for number, actor_set in enumerate(active.sets):
        segments = actor_segments(actor_set, rays, sampling, number, first, among if number == 0 else None)
        first += len(actor_set.uids)
        if segments is not None:
            actors.append(segments)
    static = static_segments(
        scene, StaticMask(scene, active, rays, actors, sampling.padding is not None), rays, sampling
    )
    ray_segments: list[RaySegments] = [*([static] if len(static) else []), *actors]
    copies = copied_segments(scene, active, rays, sampling)
    if copies is not None:
        ray_segments.append(copies)
    if mesh_hits is not None and len(mesh_hits.ray):
        ray_segments.append(mesh_segments(mesh_hits, rays.origins, first))
    traced = composite(len(rays), ray_segments, [each.scene.config.features for each in active.sets], rays.origins,
                       sampling.padding is not None)  # fmt: skip
    seen = BackgroundSamples(traced.feature, traced.depth_m, traced.opacity, traced.transmittance_after)
    reach = None
    alone = None
    if active.foreign or mesh_hits is not None:
        alone, reach = _without_foreign(traced, ray_segments)
    samples, background = sum(s.t.numel() for s in ray_segments), None
    # the scene's own decoder, too, sees what lies behind foreign actors
    behind = None
    if sampling.background:
        behind = background_along(scene, rays, sampling, seen.transmittance_after if reach is None else reach)
    if behind is not None:
        samples += behind.samples
        seen, background = behind.behind(traced)
        if alone is not None and reach is not None:
            alone = behind.feature_behind(alone, reach)
    return SegmentTrace(
        **seen._asdict(),
        volume_depth_m=traced.depth_m,
        volume_opacity=traced.opacity,
        ray_segments=tuple(ray_segments),
        weights=traced.weights,
        samples=samples,
        foreign_features=traced.foreign_features,
        foreign_opacity=traced.foreign_opacity,
        background=background,
        without_foreign=alone,
        mesh_opacity=None if mesh_hits is None else traced.mesh_opacity,
    )


def _without_foreign(traced: Composite, ray_segments: list[RaySegments]) -> tuple[Tensor, Tensor]:
    """Return features (N, F) and transmittances (N,) behind the volume without foreign actors and meshes: composited
    again on the rays that hit one, unchanged on the others."""
    hit = torch.zeros_like(traced.opacity, dtype=torch.bool)
    own = []
    for segments in ray_segments:
        if isinstance(segments, MeshSegments) or (isinstance(segments, ActorSegments) and segments.actor_set > 0):
            hit[segments.ray] = True
        else:
            own.append(segments)
    if not bool(hit.any()):
        return traced.feature, traced.transmittance_after
    behind = [rows_of(segments, hit[segments.ray]) for segments in own]
    alone = composite(len(hit), [s for s in behind if len(s)], [traced.feature.shape[1]], traced.feature)
    feature = torch.where(hit[:, None], alone.feature, traced.feature)
    return feature, torch.where(hit, alone.transmittance_after, traced.transmittance_after)
