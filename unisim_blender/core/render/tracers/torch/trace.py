"""Rays through the scene: samples placed, fields asked, everything along one ray put in depth order, weights, features.

The one path that training and rendering share.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from ....meshes.hits import MeshHits
from ....model.scene import SceneModel
from ....model.tracklets import Hits
from ....ops.composite import composite
from ....ops.constants import CLEARANCE_M, EMPTY_M, OPAQUE, WHOLE
from ....ops.density import logistic_intervals, unisim_intervals, volume_density, volume_intervals, weights_from_tau
from ....ops.march import Segment, propose, refine_by_density, refine_quantiles, stratified
from ....ops.ray_segments import RayBatch, RaySegments, SegmentTrace
from ...tracer import NEAR_M
from .actor_tensors import ActiveActorTensors, ActorSetTensors

_LOOKS = 3
"""Places between two samples at which the voxels are asked how much of the way is free."""


@dataclass(frozen=True)
class Sampling:
    """``jitter`` draws samples at random in their strata; ``fine`` multiplies their number in the volume, ``far_fine`` beyond it;
    ``far`` asks for the far field, ``sky`` for what lies behind that and for the light it gives: a camera sees them, a LiDAR does
    not."""

    jitter: bool = False
    fine: float = 1.0
    far_fine: float = 1.0
    far: bool = True
    sky: bool = True
    mirror: Tensor | None = None
    """(looks,) chance that a look is mirrored, in training: on all the rays that are traced together."""
    generator: torch.Generator | None = None


def trace(
    scene: SceneModel,
    active: ActiveActorTensors,
    rays: RayBatch,
    sampling: Sampling,
    among: Tensor | None = None,
    mesh_hits: MeshHits | None = None,
) -> SegmentTrace:
    """Features, depths and opacities of rays. ``among`` names the own actors that can be mesh_hits, the others are skipped;
    ``mesh_hits`` is where rays meet meshes."""
    actors = _actor_segments(active.own, rays, sampling, among, first=0, foreign=-1)
    first = len(active.own.uids)
    for i, actor_set in enumerate(active.foreign.values()):
        actors += _actor_segments(actor_set, rays, sampling, None, first=first, foreign=i)
        first += len(actor_set.uids)
    static = _static_segments(scene, active, rays, sampling, actors)
    ray_segments = [s for s in (static, *actors, *_copy_segments(scene, active, rays, sampling)) if len(s.ray)]
    widths = [actor_set.scene.config.features for actor_set in active.foreign.values()]
    seen = []
    if mesh_hits is not None:
        ray_segments += [_surfaces(mesh_hits, rays, first, len(widths))] if len(mesh_hits.ray) else []
        widths.append(1)
    if active.foreign or mesh_hits is not None:
        # what the scene's own decoder is to see: everything but the foreign actors. First, for ray segments keep the weights of
        # the last
        own = [ray_segment for ray_segment in ray_segments if ray_segment.foreign < 0]
        seen.append(composite(len(rays), own, scene.config.features, [], rays.origins))
    traced = composite(len(rays), ray_segments, scene.config.features, widths, rays.origins)
    seen.append(traced)
    far = _far(scene, rays, sampling, seen[0].transmittance_after) if sampling.far else None
    if far is not None:
        traced.samples += far.t.numel() + len(far.ray)
        for result in seen:
            _add_far(far, result)
    if active.foreign or mesh_hits is not None:
        traced.without_foreign = seen[0].feature
    if mesh_hits is not None:
        traced.mesh_opacity = traced.foreign_opacity.pop()
        traced.foreign_features.pop()
    traced.samples += sum(s.t.numel() for s in ray_segments)
    return traced


def _intervals(scene: SceneModel, s: Tensor, t: Tensor, length_m: Tensor | None, actor: bool) -> tuple[Tensor, Tensor]:
    beta = scene.beta()
    if length_m is not None:
        return volume_intervals(s, length_m)
    if scene.config.density == "unisim":
        return unisim_intervals(s, t, beta, scene.config.unisim_step_m if not actor else scene.config.unisim_step_m / 4)
    return logistic_intervals(s, beta)


@torch.no_grad()
def _lengths(scene: SceneModel, o: Tensor, d: Tensor, t: Tensor) -> Tensor | None:
    """Metres (N, K) of occupied voxels between each sample t (N, K) of rays o, d (N, 3) and the one before: a density has none
    where a voxel is free, and samples lie on both sides of much free space. None for signed distances, which need no lengths."""
    if scene.config.density != "volume":
        return None
    least = scene.config.voxel_m / 2
    gap = torch.diff(t, dim=1, prepend=t[:, :1] - least)
    share = (torch.arange(_LOOKS, device=t.device) + 0.5) / _LOOKS
    x = o[:, None, None] + (t[..., None] - gap[..., None] * share)[..., None] * d[:, None, None]
    occupied = scene.occupancy.values.view(-1)[scene.occupancy.cells(x.reshape(-1, 3))] > 0
    # a sample that was placed behind free space stands in a voxel that is occupied
    return torch.maximum(gap * occupied.view(x.shape[:3]).to(gap.dtype).mean(-1), gap.clamp_max(least))


def _refined(scene: SceneModel, u: Tensor, t: Tensor, s: Tensor, length_m: Tensor | None, jitter: Tensor) -> Tensor:
    """Quantiles like ``jitter`` (N, K'), where s (N, K) at places t (N, K), quantiles u (N, K), says that rays stop."""
    if length_m is not None:
        return refine_by_density(u, volume_density(s) * length_m, jitter)
    return refine_quantiles(u, t, s, float(scene.beta().detach()), jitter.shape[1], jitter)


def _along(o: Tensor, d: Tensor, t: Tensor) -> Tensor:
    """Points (N, K, 3) at distances t (N, K) along rays o, d (N, 3)."""
    # a sum after a product of shapes that spread would take four times as long
    return torch.addcmul(o[:, None], t[..., None], d[:, None])


def _count(n: int, sampling: Sampling) -> int:
    return max(2, round(n * sampling.fine))


def _far_count(n: int, sampling: Sampling) -> int:
    return max(2, round(n * sampling.far_fine))


def _static_segments(
    scene: SceneModel, active: ActiveActorTensors, rays: RayBatch, sampling: Sampling, actors: list[RaySegments]
) -> RaySegments:
    o, d = scene.frame.points(rays.origins), scene.frame.vectors(rays.directions)
    t_near, t_far = scene.frame.span(o, d, NEAR_M)
    if rays.starts is not None:
        t_near = torch.minimum(torch.maximum(t_near, rays.starts), t_far)
    n, samples = len(rays), scene.config.samples
    u = stratified(n, _count(samples.static_proposals, sampling), sampling.jitter, o, sampling.generator)
    with torch.no_grad():
        t, mass = propose(scene.occupancy.voxels, Segment(o, d, t_near, t_far), u)
        ray = torch.nonzero((mass > 0) & (t_far > t_near))[:, 0]
        # free space: rays that meet no occupied voxel take no sample
        o, d, u, t = o[ray], d[ray], u[ray], t[ray]
        segment = Segment(o, d, t_near[ray], t_far[ray])
        points = _along(o, d, t)
        s = scene.static.distance(points.reshape(-1, 3)).view(t.shape)
        s = _cleared(scene, active, rays, actors, ray, t, points, s)
        jitter = stratified(len(ray), _count(samples.static, sampling), sampling.jitter, o, sampling.generator)
        quantiles = _refined(scene, u, t, s, _lengths(scene, o, d, t), jitter)
        t, _ = propose(scene.occupancy.voxels, segment, quantiles)
    points = _along(o, d, t)
    s, feature = scene.static(points.reshape(-1, 3))
    feature = scene.directed(feature, rays.directions[ray].repeat_interleave(t.shape[1], 0))
    s = _cleared(scene, active, rays, actors, ray, t, points, s.view(t.shape))
    tau, stop_fraction = _intervals(scene, s, t, _lengths(scene, o, d, t), actor=False)
    field = torch.full_like(ray, -1)
    feature = feature.view(*t.shape, scene.config.features)
    return RaySegments(ray, t, s, feature, tau, stop_fraction, points, field, beta=float(scene.beta().detach()))


def _actor_segments(
    actor_set: ActorSetTensors, rays: RayBatch, sampling: Sampling, among: Tensor | None, first: int, foreign: int
) -> list[RaySegments]:
    if not actor_set.uids or (among is not None and len(among) == 0):
        return []
    hits = actor_set.tracklets.hits(rays.origins, rays.directions, rays.time_s, NEAR_M, among, actor_set.keys)
    if len(hits.ray) == 0:
        return []
    scene, samples = actor_set.scene, actor_set.scene.config.samples
    size, row = actor_set.tracklets.sizes_m[hits.actor], actor_set.rows[hits.actor]
    flip = None
    if sampling.mirror is not None:
        # an actor at a time: rays that turned one by one would be noise, which the decoder learns to blur
        chance = torch.rand(len(sampling.mirror), generator=sampling.generator, device=row.device)
        flip = torch.where(chance < sampling.mirror, -1.0, 1.0)[row]

    def unit(t: Tensor) -> Tensor:
        x = _along(hits.origins, hits.directions, t) / size[:, None]
        if flip is not None:
            x = torch.stack([x[..., 0], x[..., 1] * flip[:, None], x[..., 2]], -1)
        return x + 0.5

    span = (hits.t_far - hits.t_near)[:, None]

    def field_m(length: Tensor) -> Tensor:
        """Lengths along the rays in the metres of the actor's field: its distances and densities are in these."""
        return length if hits.stretch is None else length * hits.stretch[:, None]

    with torch.no_grad():
        count = _count(samples.actor_proposals, sampling)
        u = stratified(len(row), count, sampling.jitter, span, sampling.generator)
        t = hits.t_near[:, None] + u * span
        s = scene.actors.distance(actor_set.tables, unit(t).reshape(-1, 3), row.repeat_interleave(count)).view(t.shape)
        jitter = stratified(len(row), _count(samples.actor, sampling), sampling.jitter, span, sampling.generator)
        even = field_m((span / count).expand_as(t)) if scene.config.density == "volume" else None
        t = hits.t_near[:, None] + _refined(scene, u, field_m(t), s, even, jitter) * span
        length = field_m(torch.diff(t, dim=1, prepend=hits.t_near[:, None])) if even is not None else None
    points = unit(t)
    s, feature = scene.actors(actor_set.tables, points.reshape(-1, 3), row.repeat_interleave(t.shape[1]))
    s = s.view(t.shape)
    tau, stop_fraction = _intervals(scene, s, field_m(t), length, actor=True)
    if sampling.sky and scene.light is not None:
        middle = rays.origins[hits.ray] + t.gather(1, _median(tau)) * rays.directions[hits.ray]
        place = scene.frame.points(middle) if foreign < 0 else scene.light.home[row]
        feature = scene.lit(feature.view(*t.shape, -1), place).flatten(0, 1)
    # a scaled actor too is looked at along the ray as it is in the world, as heads do that see a ray's sum: what the direction
    # tells is the light, which an edit of the size leaves
    directions = rays.directions[hits.ray]
    if flip is not None:
        directions = _mirrored(directions, hits.world_from_box[:, :, 1], flip)
    feature = scene.directed(feature, directions.repeat_interleave(t.shape[1], 0))
    return [
        RaySegments(
            hits.ray,
            t,
            s,
            feature.view(*t.shape, scene.config.features),
            tau,
            stop_fraction,
            points,
            hits.actor + first,
            foreign,
            (hits.t_near, hits.t_far),
            hits.world_from_box,
            size,
            float(scene.beta().detach()),
        )
    ]


@torch.no_grad()
def _median(tau: Tensor) -> Tensor:
    """The sample (P, 1) at which a ray segment with optical depths tau (P, K) alone has stopped half of what it stops of its
    ray."""
    stopped = -torch.expm1(-tau.cumsum(1))
    return (stopped[:, :-1] < stopped[:, -1:] / 2).sum(1, keepdim=True)


def _mirrored(directions: Tensor, across: Tensor, flip: Tensor) -> Tensor:
    """Directions (P, 3) as a box sees them whose axis ``across`` (P, 3) is flipped where ``flip`` (P,) is -1."""
    return directions + ((flip - 1) * (directions * across).sum(-1))[:, None] * across


def _copy_segments(scene: SceneModel, active: ActiveActorTensors, rays: RayBatch, sampling: Sampling) -> list[RaySegments]:
    """What stands above the ground in a source box, seen where its copy stands."""
    if active.copies is None or active.copy_source is None:
        return []
    hits: Hits = active.copies.hits(rays.origins, rays.directions, rays.time_s, NEAR_M)
    if len(hits.ray) == 0:
        return []
    samples = scene.config.samples
    pose = active.copy_source[hits.actor]
    o = scene.frame.points(torch.einsum("pij,pj->pi", pose[:, :3, :3], hits.origins) + pose[:, :3, 3])
    d = scene.frame.vectors(torch.einsum("pij,pj->pi", pose[:, :3, :3], hits.directions))
    span = (hits.t_far - hits.t_near)[:, None]
    u = stratified(len(o), _count(2 * samples.static, sampling), sampling.jitter, o, sampling.generator)
    t = hits.t_near[:, None] + u * span
    points = _along(o, d, t)
    s, feature = scene.static(points.reshape(-1, 3))
    # the source's ground stays where it is
    s = torch.where(scene.ground.above(points.reshape(-1, 3)), s, EMPTY_M).view(t.shape)
    feature = scene.directed(feature, rays.directions[hits.ray].repeat_interleave(t.shape[1], 0))
    length = torch.diff(t, dim=1, prepend=hits.t_near[:, None]) if scene.config.density == "volume" else None
    tau, stop_fraction = _intervals(scene, s, t, length, actor=False)
    field = torch.full_like(hits.ray, -2)
    feature = feature.view(*t.shape, scene.config.features)
    ray_segments = RaySegments(hits.ray, t, s, feature, tau, stop_fraction, points, field, beta=float(scene.beta().detach()))
    ray_segments.world_from_box = hits.world_from_box @ pose[:, :3, :3].mT
    return [ray_segments]


def _surfaces(mesh_hits: MeshHits, rays: RayBatch, first: int, foreign: int) -> RaySegments:
    """Meshes as ray segments of one sample: opaque there as far as they cover the ray. They have no features."""

    def tensor(values: NDArray[Any]) -> Tensor:
        return torch.as_tensor(values).to(rays.origins.device, rays.origins.dtype)

    t = tensor(mesh_hits.t)[:, None]
    tau = -torch.log1p(-tensor(mesh_hits.share).clamp_max(1 - WHOLE))[:, None]
    nothing, number = torch.zeros_like(t), torch.as_tensor(mesh_hits.actor, device=t.device) + first
    ray, points = torch.as_tensor(mesh_hits.ray, device=t.device), rays.origins.new_zeros(len(t), 1, 3)
    bounds = t[:, 0], t[:, 0]
    return RaySegments(
        ray, t, nothing, nothing[..., None], tau, nothing, points, number, foreign, bounds, normals=tensor(mesh_hits.normals)
    )  # fmt: skip


def _cleared(
    scene: SceneModel,
    active: ActiveActorTensors,
    rays: RayBatch,
    actors: list[RaySegments],
    ray: Tensor,
    t: Tensor,
    points: Tensor,
    s: Tensor,
) -> Tensor:
    """The static field's distances s (P, K) at samples t (P, K), points (P, K, 3), of rays (P,), as a ray may meet them.

    Inside a present actor's box, and in a removed box, nothing stands above the ground: the ground is then all that is near. A
    density is nothing there.
    """
    inside = _in_boxes(active, rays, actors, ray, t)
    rows, columns = torch.nonzero(inside, as_tuple=True)
    if len(rows) == 0:
        return s
    x = points[rows, columns]
    height = x[:, 2] - scene.ground.height(x)
    own = s[rows, columns]
    empty = torch.full_like(own, EMPTY_M) if scene.config.density == "volume" else torch.maximum(own, height)
    return s.index_put((rows, columns), torch.where(height > CLEARANCE_M, empty, own))


@torch.no_grad()
def _in_boxes(active: ActiveActorTensors, rays: RayBatch, actors: list[RaySegments], ray: Tensor, t: Tensor) -> Tensor:
    """Which samples t (P, K) of rays (P,) lie in the box of an actor that the ray meets, or in a removed one: (P, K)."""
    covers = torch.zeros_like(t)
    row_of_ray = torch.full((len(rays),), -1, dtype=torch.long, device=t.device)
    row_of_ray[ray] = torch.arange(len(ray), device=t.device)
    for ray_segment in actors:
        assert ray_segment.bounds is not None
        row = row_of_ray[ray_segment.ray]
        known = row >= 0
        row, near, far = row[known], ray_segment.bounds[0][known], ray_segment.bounds[1][known]
        covered = (t[row] >= near[:, None]) & (t[row] <= far[:, None])
        covers.index_put_((row,), covered.to(covers.dtype), accumulate=True)
    inside = covers > 0
    if active.removals is not None:
        for pose, size in zip(*active.removals, strict=True):
            x = rays.origins[ray][:, None] + t[..., None] * rays.directions[ray][:, None]
            inside |= ((x @ pose[:3, :3].mT + pose[:3, 3]).abs() <= size / 2).all(-1)
    return inside


def _disparity(u: Tensor, t0: Tensor, far_m: float) -> Tensor:
    """Distances at shares u (N, K) of the way from t0 (N, 1) to far_m, even in disparity."""
    return 1 / ((1 - u) / t0 + u / far_m)


@torch.no_grad()
def _far_places(scene: SceneModel, o: Tensor, d: Tensor, t0: Tensor, sampling: Sampling) -> tuple[Tensor, Tensor]:
    """Where behind the volume, whose end is t0 (N, 1), the far field is asked, as shares of disparity (N, K), and the lengths
    (N, K) of the intervals round the places: most where a first, even set of densities says that something is."""
    samples = scene.config.samples
    proposals, count = _far_count(samples.far_proposals, sampling), _far_count(samples.far, sampling)
    u = stratified(len(o), proposals, sampling.jitter, o, sampling.generator)
    x = _along(o, d, _disparity(u, t0, scene.config.far_m))
    tau = scene.far.density(x.reshape(-1, 3)).view(u.shape) / proposals
    weight = weights_from_tau(tau)[0] * -torch.expm1(-tau) + 1e-3
    cdf = F.pad((0.8 * weight / weight.sum(-1, keepdim=True) + 0.2 / proposals).cumsum(-1), (1, 0))
    cdf = cdf / cdf[:, -1:]
    ends = torch.linspace(0, 1, count + 1, device=o.device, dtype=o.dtype).expand(len(o), -1).contiguous()
    j = torch.searchsorted(cdf, ends, right=True).clamp(1, proposals)
    c0, c1 = cdf.gather(1, j - 1), cdf.gather(1, j)
    edges = (j - 1 + (ends - c0) / (c1 - c0)) / proposals
    width = torch.diff(edges, dim=-1)
    inside = stratified(len(o), count, sampling.jitter, o, sampling.generator) * count
    inside = inside - torch.arange(count, device=o.device)
    return edges[:, :-1] + inside * width, width


@dataclass(frozen=True)
class _Far:
    """The far field and the sky along rays (R,): places t, densities times lengths tau, weights (R, K) of what stops there,
    transmittance in front of each (R, K) and behind all (R,), features (R, F)."""

    ray: Tensor
    t: Tensor
    tau: Tensor
    weight: Tensor
    transmittance_before: Tensor
    transmittance_after: Tensor
    feature: Tensor


def _far(scene: SceneModel, rays: RayBatch, sampling: Sampling, reach: Tensor) -> _Far | None:
    """What lies behind the volume, along the rays of which a share ``reach`` (N,) that counts comes through; None for none."""
    ray = torch.nonzero(reach.detach() > OPAQUE)[:, 0]
    if len(ray) == 0:
        return None
    o, d = scene.frame.points(rays.origins[ray]), scene.frame.vectors(rays.directions[ray])
    _, t_far = scene.frame.span(o, d, NEAR_M)
    t0 = t_far.clamp_min(NEAR_M)[:, None]
    u, width = _far_places(scene, o, d, t0, sampling)
    t = _disparity(u, t0, scene.config.far_m)
    density, feature = scene.far(_along(o, d, t).reshape(-1, 3))
    tau = density.view(u.shape) * width
    before, after = weights_from_tau(tau)
    weight = before * -torch.expm1(-tau)
    directions = rays.directions[ray]
    feature = scene.directed(feature, directions.repeat_interleave(u.shape[1], 0)).view(*u.shape, -1)
    feature = (weight[..., None] * feature).sum(1)
    if sampling.sky:
        feature = feature + after[:, None] * scene.directed(scene.far.sky(d), directions)
    return _Far(ray, t, tau, weight, before, after, feature)


def _add_far(far: _Far, traced: SegmentTrace) -> None:
    """Put the far field behind what was met in the volume."""
    ray, reach = far.ray, traced.transmittance_after[far.ray]
    stopped = traced.depth_m * traced.opacity
    stopped = stopped.index_add(0, ray, reach * (far.weight * far.t).sum(1))
    traced.far = (ray, far.t, far.tau, reach[:, None] * far.transmittance_before)
    traced.feature = traced.feature.index_add(0, ray, reach[:, None] * far.feature)
    traced.transmittance_after = traced.transmittance_after.index_put((ray,), reach * far.transmittance_after)
    traced.opacity = 1 - traced.transmittance_after
    traced.depth_m = stopped / traced.opacity.clamp_min(1e-6)
