"""The passes of traced rays: depth, normal, instance, opacity and unsupported.

A ray's depth is the median: the distance at which half of what stops it has done so. The mean of what a ray hits moves
by a metre when a thousandth of it lies a kilometre behind, and between a car's edge and the wall behind it lies on
neither; a LiDAR reports the one or the other. On a plane both are the distance to it.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from ....model.checkpoint import TorchScene
from ....model.fields import CORNERS, outward_gradient
from ....ops.constants import NORMAL_STEP_M
from ....ops.field_values import SignedDistances
from ....ops.ray_segments import ActorSegments, CopiedBoxSegments, FieldSegments, MeshSegments, RayBatch, RaySegments
from ....ops.segment_trace import SegmentTrace
from ...tracer import Maps
from .actor_tensors import ActiveActorTensors


@torch.no_grad()
def median_depth(traced: SegmentTrace) -> Tensor:
    """Return the median distance (N,), metres, of what stopped each ray, with the background model and without the sky;
    0 where nothing did."""
    target = (1 + traced.transmittance_after) / 2
    depth = torch.zeros_like(traced.opacity)
    for segments, weights in traced.weighted():
        wanted, before = target[segments.ray][:, None], weights.transmittance_before
        row, k = _crossed(before, segments.tau, wanted)
        near = segments.t[row, (k - 1).clamp_min(0)]
        fraction = _fraction(segments, before, row, k, wanted[row, 0])
        depth[segments.ray[row]] = near + torch.where(k > 0, fraction, torch.zeros_like(fraction)) * (
            segments.t[row, k] - near
        )
    # between two intervals the transmittance may fall to `wanted` by rounding alone: the crossing is their border
    missing = depth == 0
    least = torch.full_like(depth, 2.0)
    for segments, weights in traced.weighted():
        before = torch.where(
            weights.transmittance_before > target[segments.ray][:, None], weights.transmittance_before, 2
        )
        least.scatter_reduce_(0, segments.ray, before.amin(1), "amin")
    for segments, weights in traced.weighted():
        before = weights.transmittance_before
        is_last = missing[segments.ray][:, None] & (before == least[segments.ray][:, None])
        depth.scatter_reduce_(0, segments.ray, torch.where(is_last, segments.t, 0).amax(1), "amax")
    if traced.background is not None:
        behind = traced.background
        row, k = _crossed(behind.transmittance_before, behind.tau, target[behind.ray][:, None])
        depth[behind.ray[row]] = behind.t[row, k]
    return depth


def _crossed(before: Tensor, tau: Tensor, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """Rows and intervals (M,), (M,) in which transmittances, ``before`` (P, K) the intervals, fall to ``wanted`` (P,
    1)."""
    row, k = torch.nonzero((before > wanted) & (before * torch.exp(-tau) <= wanted), as_tuple=True)
    return row, k


def _fraction(segments: RaySegments, before: Tensor, row: Tensor, k: Tensor, wanted: Tensor) -> Tensor:
    """Return the fraction of interval k of each row, 0 to 1, at which the transmittance falls to ``wanted``. Between
    samples signed distances of the logistic density are linear; others stop rays at the far sample, as meshes do."""
    if not isinstance(segments, FieldSegments) or segments.density != "logistic":
        return torch.ones_like(wanted)
    assert isinstance(segments.values, SignedDistances)
    s, beta = segments.values.metres, segments.beta
    s1, s2 = s[row, (k - 1).clamp_min(0)], s[row, k]
    # -log Phi at the place, then its distance: the inverse of softplus(-beta s)
    y = F.softplus(-beta * s1) + torch.log(before[row, k] / wanted)
    at = -(y + torch.log(-torch.expm1(-y.clamp_min(1e-12)))) / beta
    return ((s1 - at) / (s1 - s2).clamp_min(1e-9)).clamp(0, 1)


def ray_passes(
    scene: TorchScene, active: ActiveActorTensors, part: RayBatch, traced: SegmentTrace, passes: set[str]
) -> Maps:
    """Return one array (N, ...) for each of ``passes``, of traced rays."""
    maps: Maps = {}
    solid = traced.opacity > 0.5
    if passes & {"depth", "unsupported"}:
        depth = torch.where(solid, median_depth(traced), torch.inf)
    if passes & {"instance", "unsupported"}:
        instance = _instances(traced, len(part))
    if "depth" in passes:
        maps["depth"] = depth.cpu().numpy()
    if "opacity" in passes:
        maps["opacity"] = traced.opacity.cpu().numpy()
    if "instance" in passes:
        maps["instance"] = instance.cpu().numpy()
    if "normal" in passes:
        maps["normal"] = _normals(scene, active, traced, part, solid).cpu().numpy()
    if "unsupported" in passes:
        maps["unsupported"] = (~_supported(scene, part, depth, instance)).cpu().numpy()
    return maps


def _instances(traced: SegmentTrace, rays: int) -> Tensor:
    """Return 1 + the number of the actor with the largest weight on each ray (N,), 0 where the rest outweighs it."""
    best = traced.feature.new_zeros(rays)
    rest = traced.transmittance_after.clone()
    actors: list[tuple[ActorSegments | MeshSegments, Tensor]] = []
    for segments, weights in traced.weighted():
        total = weights.samples.sum(1)
        if isinstance(segments, ActorSegments | MeshSegments):
            actors.append((segments, total))
            best.scatter_reduce_(0, segments.ray, total, "amax")
        else:
            rest.index_add_(0, segments.ray, total)
    out = torch.zeros(rays, dtype=torch.long, device=best.device)
    for segments, total in actors:
        heaviest = total == best[segments.ray]
        # of several ray segments of one ray one order must decide: writing to one place by turns has none
        out.scatter_reduce_(0, segments.ray[heaviest], segments.actor[heaviest] + 1, "amax")
    return torch.where(best > rest, out, torch.zeros_like(out))


def _normals(
    scene: TorchScene, active: ActiveActorTensors, traced: SegmentTrace, part: RayBatch, solid: Tensor
) -> Tensor:
    """Return unit normals (N, 3), world frame, 0 where nothing solid is: each segment's gradient towards free space at
    its heaviest sample, by central differences on a tetrahedron, weighted by the segment's weight on the ray."""
    out = torch.zeros_like(part.directions)
    for segments, weights in traced.weighted():
        weight, heaviest = weights.samples.sum(1), weights.samples.argmax(1)
        if isinstance(segments, MeshSegments):
            normal = segments.normals
        else:
            assert isinstance(segments, FieldSegments)
            normal = F.normalize(_outward(scene, active, segments, heaviest), dim=-1)
        out.index_add_(0, segments.ray, weight[:, None] * normal)
    return torch.where(solid[:, None], F.normalize(out, dim=-1), torch.zeros_like(out))


def _outward(scene: TorchScene, active: ActiveActorTensors, segments: FieldSegments, sample: Tensor) -> Tensor:
    """Return gradients (P, 3) towards free space, world frame, at one sample (P,) of each ray segment."""
    x = segments.points[torch.arange(len(sample), device=sample.device), sample]
    if isinstance(segments, ActorSegments):
        gradient = outward_gradient(_actor_outward(active, segments), x, NORMAL_STEP_M, segments.size_m)
        return torch.einsum("nij,nj->ni", segments.world_from_box, gradient)
    static = scene.model.static
    gradient = outward_gradient(lambda y: static.values(y).outward(), x, NORMAL_STEP_M) @ scene.model.frame.rotation
    if isinstance(segments, CopiedBoxSegments):
        return torch.einsum("nij,nj->ni", segments.copy_from_source, gradient)
    return gradient


def _actor_outward(active: ActiveActorTensors, segments: ActorSegments) -> Callable[[Tensor], Tensor]:
    """Return a function that rises towards free space in actors' fields, at points in their unit cubes, `CORNERS` for
    each ray segment."""
    actor_set = active.sets[segments.actor_set]
    row = segments.row.repeat_interleave(CORNERS)
    return lambda y: actor_set.scene.actors.values(actor_set.tables, y, row).outward()


def _supported(scene: TorchScene, part: RayBatch, depth_m: Tensor, instance: Tensor) -> Tensor:
    """Return which rays (N,) end where the recording saw something: an observed voxel, an actor, or beyond the
    volume."""
    model = scene.model
    x = model.frame.points(part.origins + part.directions * torch.nan_to_num(depth_m, posinf=1e6)[:, None])
    outside = ((x < 0) | (x > model.frame.size_m)).any(-1)
    seen = model.observed.view(-1)[model.occupancy.cells(x)] > 0
    return outside | seen | (instance > 0)
