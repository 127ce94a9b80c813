"""The passes of traced rays: depth, normal, instance, opacity, and what nothing recorded supports."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from ....model.files.checkpoint import TorchScene
from ....model.gradient import CORNERS, outward_gradient
from ....ops.constants import NORMAL_STEP_M
from ....ops.ray_segments import ActorSegments, CopiedBoxSegments, FieldSegments, MeshSegments, RayBatch
from ....ops.segment_trace import SegmentTrace
from ...tracer import Maps
from .actor_tensors import ActiveActorTensors
from .median import median_depth


def ray_passes(
    scene: TorchScene, active: ActiveActorTensors, part: RayBatch, traced: SegmentTrace, passes: set[str]
) -> Maps:
    """One array (N, ...) for each pass asked for, of rays that were traced."""
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
    """1 + the number of the actor with the largest weight on each ray (N,), 0 where the rest outweighs it."""
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
    """Unit normals (N, 3), world frame, 0 where nothing solid is: each segment's gradient towards free space at its
    heaviest sample, by central differences on a tetrahedron, weighted with what the ray segment gives to the ray."""
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
    """Gradients (P, 3) towards free space, directions of the world, at one sample (P,) of each ray segment."""
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
    """What rises towards free space in actors' fields, at points in their unit cubes, `CORNERS` for each ray
    segment."""
    actor_set = active.sets[segments.actor_set]
    first = sum(len(each.uids) for each in active.sets[: segments.actor_set])
    row = actor_set.rows[segments.actor - first].repeat_interleave(CORNERS)
    return lambda y: actor_set.scene.actors.values(actor_set.tables, y, row).outward()


def _supported(scene: TorchScene, part: RayBatch, depth_m: Tensor, instance: Tensor) -> Tensor:
    """Which rays (N,) end where the recording saw something: an observed voxel, an actor, or beyond the volume."""
    model = scene.model
    x = model.frame.points(part.origins + part.directions * torch.nan_to_num(depth_m, posinf=1e6)[:, None])
    outside = ((x < 0) | (x > model.frame.size_m)).any(-1)
    seen = model.observed.view(-1)[model.occupancy.cells(x)] > 0
    return outside | seen | (instance > 0)
