"""Ray segments through each kind of field: samples placed, the field queried, its values turned into optical
depths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from numpy.typing import NDArray
from torch import Tensor

from ....meshes.hits import MeshHits
from ....model.scene import SceneModel
from ....ops.constants import COVERED_TRANSMITTANCE
from ....ops.density import logistic_intervals, unisim_intervals, volume_density, volume_intervals
from ....ops.field_values import FieldValues, LogDensities
from ....ops.padding import Padding
from ....ops.propose import RaySpans, propose
from ....ops.quantiles import refine_by_density, refine_quantiles, stratified
from ....ops.ray_segments import ActorSegments, CopiedBoxSegments, MeshSegments, RayBatch, StaticSegments
from ...tracer import NEAR_M
from .actor_tensors import ActiveActorTensors, ActorSetTensors
from .places import BoxSpans, are_compiled, static_places

_LOOKUPS_PER_INTERVAL = 3
"""Number of places between two samples at which the voxels are looked up for the free part of the way."""

Lengths = Callable[[], Tensor]
"""Function that returns the lengths (N, K), metres, of intervals, which only densities need."""


def intervals(
    scene: SceneModel, values: FieldValues, t: Tensor, lengths: Lengths, step_m: float
) -> tuple[Tensor, Tensor]:
    """Return optical depths and stop fractions (N, K) of intervals between samples at t (N, K), in the metres of the
    field, with values (N, K); ``step_m`` is the one of UniSim's density."""
    if isinstance(values, LogDensities):
        with torch.no_grad():
            length_m = lengths()
        return volume_intervals(values.logs, length_m)
    if scene.config.density == "unisim":
        return unisim_intervals(values.metres, t, scene.beta(), step_m)
    return logistic_intervals(values.metres, scene.beta())


@torch.no_grad()
def refined(scene: SceneModel, values: FieldValues, u: Tensor, t: Tensor, lengths: Lengths, jitter: Tensor) -> Tensor:
    """Return quantiles like ``jitter`` (N, K') where rays stop by values (N, K) at places t (N, K), quantiles u (N,
    K)."""
    if isinstance(values, LogDensities):
        return refine_by_density(u, volume_density(values.logs) * lengths(), jitter)
    return refine_quantiles(u, t, values.metres, scene.beta(), jitter)


@torch.no_grad()
def occupied_lengths(scene: SceneModel, o: Tensor, d: Tensor, t: Tensor) -> Tensor:
    """Return the lengths (N, K), metres, in occupied voxels between each sample t (N, K) of rays o, d (N, 3) and the
    one before: a density is 0 where a voxel is free, and samples lie on both sides of much free space."""
    least = scene.config.voxel_m / 2
    gap = torch.diff(t, dim=1, prepend=t[:, :1] - least)
    part = (torch.arange(_LOOKUPS_PER_INTERVAL, device=t.device) + 0.5) / _LOOKUPS_PER_INTERVAL
    x = o[:, None, None] + (t[..., None] - gap[..., None] * part)[..., None] * d[:, None, None]
    occupied = scene.occupancy.values.view(-1)[scene.occupancy.cells(x.reshape(-1, 3))] > 0
    # a sample that was placed behind free space stands in a voxel that is occupied
    return torch.maximum(gap * occupied.view(x.shape[:3]).to(gap.dtype).mean(-1), gap.clamp_max(least))


def only(there: Tensor | None, values: Tensor) -> Tensor:
    """Return values (N, K) of the rows that are ``there`` (N,), and 0 in the others; all where it is None."""
    return values if there is None else torch.where(there[:, None], values, 0.0)


def along(o: Tensor, d: Tensor, t: Tensor) -> Tensor:
    """Return points (N, K, 3) at distances t (N, K) along rays o, d (N, 3)."""
    # a sum after a product of shapes that spread would take four times as long
    return torch.addcmul(o[:, None], t[..., None], d[:, None])


@dataclass(frozen=True)
class Sampling:
    """Settings of sampling. ``jitter`` draws samples at random in their strata; ``fine`` multiplies their number in the
    volume, ``background_fine`` beyond it; ``background`` queries the background model, ``sky`` the sky behind that: a
    camera sees them, a LiDAR does not."""

    jitter: bool = False
    fine: float = 1.0
    background_fine: float = 1.0
    background: bool = True
    sky: bool = True
    mirror: Tensor | None = None
    """Probability (appearances,) that an appearance is mirrored, in training: on all rays that are traced together."""
    generator: torch.Generator | None = None
    padding: Padding | None = None
    """Lengths that ray segments are padded to; None for as many ray segments as there are."""

    def count(self, samples: int) -> int:
        """Return the number of samples in the volume for ``samples`` of the configuration."""
        return max(2, round(samples * self.fine))

    def background_count(self, samples: int) -> int:
        """Return the number of samples beyond the volume for ``samples`` of the configuration."""
        return max(2, round(samples * self.background_fine))


class StaticMask:
    """Masks values of the static field along a batch of rays, of which ``actors`` are the segments in actors'
    boxes."""

    def __init__(
        self,
        scene: SceneModel,
        active: ActiveActorTensors,
        rays: RayBatch,
        actors: Sequence[ActorSegments],
        padded: bool = False,
    ) -> None:
        self.scene, self.active, self.rays, self.actors, self.padded = scene, active, rays, actors, padded

    def apply(self, values: FieldValues, ray: Tensor, t: Tensor, points: Tensor) -> FieldValues:
        """Return values (P, K) at samples t (P, K), points (P, K, 3), of rays (P,), with masked ones set to empty
        space.

        Inside a present actor's box, and in a removed box, only the ground remains: distances are those to the ground,
        and densities above it are 0.
        """
        with torch.no_grad():
            inside = self._inside(ray, t)
        if self.padded:
            height = points[..., 2] - self.scene.ground.height(points.reshape(-1, 3)).view(t.shape)
            return values.cleared(torch.where(inside, height, -torch.inf))
        rows, columns = torch.nonzero(inside, as_tuple=True)
        if len(rows) == 0:
            return values
        x = points[rows, columns]
        height = x[:, 2] - self.scene.ground.height(x)
        return values.cleared(torch.full_like(t, -torch.inf).index_put((rows, columns), height))

    def spans(self) -> BoxSpans | None:
        """Return the parts of rays in which nothing but the ground is there; None where it takes more to tell them."""
        if self.active.removals is not None or len(self.actors) > 1:
            return None
        if not self.actors:
            ray = torch.zeros(0, dtype=torch.long)
            return BoxSpans(ray, ray.float(), ray.float())
        return BoxSpans(self.actors[0].ray, self.actors[0].t_near, self.actors[0].t_far)

    def _inside(self, ray: Tensor, t: Tensor) -> Tensor:
        """Return which samples t (P, K) of rays (P,) lie in the box of an actor that the ray hits, or in a removed one:
        (P, K) bool."""
        covers = torch.zeros_like(t)
        row_of_ray = torch.full((len(self.rays),), -1, dtype=torch.long, device=t.device)
        row_of_ray[ray] = torch.arange(len(ray), device=t.device)
        for segments in self.actors:
            if len(t) == 0:
                break
            row, near, far = row_of_ray[segments.ray][:, None], segments.t_near[:, None], segments.t_far[:, None]
            at = row[:, 0].clamp_min(0)
            covers.index_add_(0, at, ((row >= 0) & (t[at] >= near) & (t[at] <= far)).to(covers.dtype))
        inside = covers > 0
        if self.active.removals is not None:
            for pose, size in zip(*self.active.removals, strict=True):
                x = self.rays.origins[ray][:, None] + t[..., None] * self.rays.directions[ray][:, None]
                inside |= ((x @ pose[:3, :3].mT + pose[:3, 3]).abs() <= size / 2).all(-1)
        return inside


ACTOR_STEPS_PER_STATIC_STEP = 4
"""Number of steps of UniSim's density in an actor's box for one in the static field."""


def static_segments(scene: SceneModel, mask: StaticMask, rays: RayBatch, sampling: Sampling) -> StaticSegments:
    """Return the ray segments through the static field; rays that hit no occupied voxel have none."""
    o, d = scene.frame.points(rays.origins), scene.frame.vectors(rays.directions)
    t_near, t_far = scene.frame.span(o, d, NEAR_M)
    if rays.starts is not None:
        t_near = torch.minimum(torch.maximum(t_near, rays.starts), t_far)
    n, samples = len(rays), scene.config.samples
    u = stratified(n, sampling.count(samples.static_proposals), sampling.jitter, o, sampling.generator)
    jitter = stratified(n, sampling.count(samples.static), sampling.jitter, o, sampling.generator)
    longest_m = None if sampling.padding is None else scene.frame.diagonal_m
    spans, there = RaySpans(o, d, t_near, t_far, longest_m), None
    boxes = mask.spans() if sampling.padding is None and are_compiled(scene, o) else None
    with torch.no_grad():
        if boxes is not None:
            t, mass = static_places(scene, spans, boxes, u, jitter)
        else:
            t, mass = propose(scene.occupancy.voxels, spans, u)
        occupied = (mass > 0) & (t_far > t_near)
        if sampling.padding is None:
            # free space: rays that hit no occupied voxel take no sample
            ray = torch.nonzero(occupied)[:, 0]
        else:
            ray, there = torch.arange(n, device=o.device), occupied
        if len(ray) < n:
            t = t[ray]
    if len(ray) < n:
        # camera corrections take gradients from where samples lie
        o, d = o[ray], d[ray]
    if boxes is None:
        with torch.no_grad():
            if len(ray) < n:
                u, jitter, t_near, t_far = u[ray], jitter[ray], t_near[ray], t_far[ray]
            points = along(o, d, t)
            values = mask.apply(scene.static.values(points.reshape(-1, 3)).view(t.shape), ray, t, points)
            quantiles = refined(scene, values, u, t, lambda: occupied_lengths(scene, o, d, t), jitter)
            t, _ = propose(scene.occupancy.voxels, RaySpans(o, d, t_near, t_far, longest_m), quantiles)
    points = along(o, d, t)
    values, feature = scene.static(points.reshape(-1, 3))
    feature = scene.directed(feature, rays.directions[ray].repeat_interleave(t.shape[1], 0))
    values = mask.apply(values.view(t.shape), ray, t, points)
    tau, stop_fraction = intervals(
        scene, values, t, lambda: occupied_lengths(scene, o, d, t), scene.config.unisim_step_m
    )  # fmt: skip
    tau, stop_fraction = only(there, tau), only(there, stop_fraction)
    return StaticSegments(
        ray=ray, t=t, features=feature.view(*t.shape, scene.config.features), tau=tau, stop_fraction=stop_fraction,
        values=values, points=points, density=scene.config.density, beta=scene.beta().detach(), there=there,
    )  # fmt: skip


def actor_segments(
    actor_set: ActorSetTensors, rays: RayBatch, sampling: Sampling, number: int, first: int, among: Tensor | None
) -> ActorSegments | None:
    """Return the ray segments through the boxes of the actor set of this ``number``, whose first actor is number
    ``first`` of all; None where no ray hits one. ``among`` are the numbers of the actors to test."""
    if not actor_set.uids or (among is not None and len(among) == 0):
        return None
    hits = actor_set.tracklets.hits(
        rays.origins, rays.directions, rays.time_s, NEAR_M, among, actor_set.keys, sampling.padding
    )
    if len(hits.ray) == 0:
        return None
    scene, samples = actor_set.scene, actor_set.scene.config.samples
    size, row = actor_set.tracklets.sizes_m[hits.actor], actor_set.rows[hits.actor]
    flip = None
    if sampling.mirror is not None:
        # an actor at a time: rays that turned one by one would be noise, which the decoder learns to blur
        chance = torch.rand(len(sampling.mirror), generator=sampling.generator, device=row.device)
        flip = torch.where(chance < sampling.mirror, -1.0, 1.0)[row]

    def unit(t: Tensor) -> Tensor:
        x = along(hits.origins, hits.directions, t) / size[:, None]
        if flip is not None:
            x = torch.stack([x[..., 0], x[..., 1] * flip[:, None], x[..., 2]], -1)
        return x + 0.5

    span = (hits.t_far - hits.t_near)[:, None]

    def field_m(length: Tensor) -> Tensor:
        """Lengths along the rays in the metres of the actor's field: its distances and densities are in these."""
        return length if hits.stretch is None else length * hits.stretch[:, None]

    with torch.no_grad():
        count = sampling.count(samples.actor_proposals)
        u = stratified(len(row), count, sampling.jitter, span, sampling.generator)
        t = hits.t_near[:, None] + u * span
        values = scene.actors.values(actor_set.tables, unit(t).reshape(-1, 3), row.repeat_interleave(count)).view(
            t.shape
        )
        jitter = stratified(len(row), sampling.count(samples.actor), sampling.jitter, span, sampling.generator)
        quantiles = refined(scene, values, u, field_m(t), lambda: field_m((span / count).expand_as(t)), jitter)
        t = hits.t_near[:, None] + quantiles * span
    points = unit(t)
    values, feature = scene.actors(actor_set.tables, points.reshape(-1, 3), row.repeat_interleave(t.shape[1]))
    values = values.view(t.shape)
    tau, stop_fraction = intervals(
        scene, values, field_m(t), lambda: field_m(torch.diff(t, dim=1, prepend=hits.t_near[:, None])),
        scene.config.unisim_step_m / ACTOR_STEPS_PER_STATIC_STEP,
    )  # fmt: skip
    tau, stop_fraction = only(hits.there, tau), only(hits.there, stop_fraction)
    if sampling.sky and scene.light is not None:
        middle = rays.origins[hits.ray] + t.gather(1, _median(tau)) * rays.directions[hits.ray]
        place = scene.frame.points(middle) if number == 0 else scene.light.home[row]
        feature = scene.lit(feature.view(*t.shape, -1), place).flatten(0, 1)
    # a scaled actor too is looked at along the ray as it is in the world, as heads do that see a ray's sum: what the
    # direction tells is the light, which an edit of the size leaves
    directions = rays.directions[hits.ray]
    if flip is not None:
        directions = _mirrored(directions, hits.world_from_box[:, :, 1], flip)
    feature = scene.directed(feature, directions.repeat_interleave(t.shape[1], 0))
    return ActorSegments(
        ray=hits.ray, t=t, features=feature.view(*t.shape, scene.config.features), tau=tau, stop_fraction=stop_fraction,
        values=values, points=points, density=scene.config.density, beta=scene.beta().detach(), actor_set=number,
        actor=hits.actor + first, t_near=hits.t_near, t_far=hits.t_far, world_from_box=hits.world_from_box, size_m=size,
    )  # fmt: skip


@torch.no_grad()
def _median(tau: Tensor) -> Tensor:
    """Return the index (P, 1) of the sample at which a ray segment with optical depths tau (P, K) reaches half of its
    opacity."""
    stopped = -torch.expm1(-tau.cumsum(1))
    return (stopped[:, :-1] < stopped[:, -1:] / 2).sum(1, keepdim=True)


def _mirrored(directions: Tensor, across: Tensor, flip: Tensor) -> Tensor:
    """Return directions (P, 3), mirrored across the axis ``across`` (P, 3) where ``flip`` (P,) is -1."""
    return directions + ((flip - 1) * (directions * across).sum(-1))[:, None] * across


def copied_segments(
    scene: SceneModel, active: ActiveActorTensors, rays: RayBatch, sampling: Sampling
) -> CopiedBoxSegments | None:
    """Return the segments of what stands above the ground in a source box, seen where its copy stands; None where no
    ray hits a copy."""
    if active.copies is None or active.copy_source is None:
        return None
    hits = active.copies.hits(rays.origins, rays.directions, rays.time_s, NEAR_M)
    if len(hits.ray) == 0:
        return None
    samples = scene.config.samples
    pose = active.copy_source[hits.actor]
    o = scene.frame.points(torch.einsum("pij,pj->pi", pose[:, :3, :3], hits.origins) + pose[:, :3, 3])
    d = scene.frame.vectors(torch.einsum("pij,pj->pi", pose[:, :3, :3], hits.directions))
    span = (hits.t_far - hits.t_near)[:, None]
    u = stratified(len(o), sampling.count(2 * samples.static), sampling.jitter, o, sampling.generator)
    t = hits.t_near[:, None] + u * span
    points = along(o, d, t)
    values, feature = scene.static(points.reshape(-1, 3))
    # the source's ground stays where it is
    values = values.where(scene.ground.above(points.reshape(-1, 3))).view(t.shape)
    feature = scene.directed(feature, rays.directions[hits.ray].repeat_interleave(t.shape[1], 0))
    tau, stop_fraction = intervals(
        scene, values, t, lambda: torch.diff(t, dim=1, prepend=hits.t_near[:, None]), scene.config.unisim_step_m
    )  # fmt: skip
    return CopiedBoxSegments(
        ray=hits.ray, t=t, features=feature.view(*t.shape, scene.config.features), tau=tau, stop_fraction=stop_fraction,
        values=values, points=points, density=scene.config.density, beta=scene.beta().detach(),
        copy_from_source=hits.world_from_box @ pose[:, :3, :3].mT,
    )  # fmt: skip


def mesh_segments(mesh_hits: MeshHits, like: Tensor, first: int) -> MeshSegments:
    """Return meshes as ray segments of one sample, whose opacity is the share of the ray that they cover. ``first`` is
    the first mesh's number."""

    def tensor(values: NDArray[Any]) -> Tensor:
        return torch.as_tensor(values).to(like.device, like.dtype)

    t = tensor(mesh_hits.t)[:, None]
    tau = -torch.log1p(-tensor(mesh_hits.share).clamp_max(1 - COVERED_TRANSMITTANCE))[:, None]
    nothing, actor = torch.zeros_like(t), torch.as_tensor(mesh_hits.actor, device=t.device) + first
    ray = torch.as_tensor(mesh_hits.ray, device=t.device)
    return MeshSegments(ray, t, nothing[..., None], tau, nothing, actor, tensor(mesh_hits.normals))
