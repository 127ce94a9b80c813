"""Rays through the scene: samples placed, fields queried, everything along one ray put in depth order, weights,
features.

The one path that training and rendering share.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ....meshes.hits import MeshHits
from ....model.scene import SceneModel
from ....ops.composite import Composite, composite
from ....ops.ray_segments import ActorSegments, MeshSegments, RayBatch, RaySegments, rows_of
from ....ops.segment_trace import SegmentTrace
from .actor_tensors import ActiveActorTensors
from .background import BackgroundSamples, background_along
from .sampling import Sampling
from .segments import actor_segments, copied_segments, mesh_segments, static_segments
from .static_mask import StaticMask


def trace(
    scene: SceneModel,
    active: ActiveActorTensors,
    rays: RayBatch,
    sampling: Sampling,
    among: Tensor | None = None,
    mesh_hits: MeshHits | None = None,
) -> SegmentTrace:
    """Features, depths and opacities of rays. ``among`` names the own actors that rays can hit, the others are
    skipped; ``mesh_hits`` is where rays hit meshes."""
    actors, first = [], 0
    for number, actor_set in enumerate(active.sets):
        found = actor_segments(actor_set, rays, sampling, number, first, among if number == 0 else None)
        first += len(actor_set.uids)
        if found is not None:
            actors.append(found)
    static = static_segments(scene, StaticMask(scene, active, rays, actors), rays, sampling)
    ray_segments: list[RaySegments] = [*([static] if len(static) else []), *actors]
    copies = copied_segments(scene, active, rays, sampling)
    if copies is not None:
        ray_segments.append(copies)
    if mesh_hits is not None and len(mesh_hits.ray):
        ray_segments.append(mesh_segments(mesh_hits, rays.origins, first))
    traced = composite(len(rays), ray_segments, [each.scene.config.features for each in active.sets], rays.origins)
    seen, reach, alone = (
        BackgroundSamples(traced.feature, traced.depth_m, traced.opacity, traced.transmittance_after),
        None,
        None,
    )
    if active.foreign or mesh_hits is not None:
        alone, reach = _without_foreign(traced, ray_segments)
    samples, told = sum(s.t.numel() for s in ray_segments), None
    # the scene's own decoder, too, sees what lies behind foreign actors
    behind = None
    if sampling.background:
        behind = background_along(scene, rays, sampling, seen.transmittance_after if reach is None else reach)
    if behind is not None:
        samples += behind.samples
        seen, told = behind.behind(traced)
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
        background=told,
        without_foreign=alone,
        mesh_opacity=None if mesh_hits is None else traced.mesh_opacity,
    )


def _without_foreign(traced: Composite, ray_segments: list[RaySegments]) -> tuple[Tensor, Tensor]:
    """Features (N, F) and transmittances (N,) behind the volume as if no foreign actor and no mesh were there:
    composited anew on the rays that hit one, the others' are the same."""
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
