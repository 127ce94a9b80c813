"""The passes of traced rays: depth, normal, instance, opacity, and what nothing recorded supports."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor

from ....model.checkpoint import Scene
from ....model.gradient import CORNERS, distance_gradient
from ....ops.constants import NORMAL_STEP_M
from ....ops.ray_segments import RayBatch, RaySegments, SegmentTrace
from ...tracer import Maps
from .actor_tensors import ActiveActorTensors
from .median import median_depth


def ray_passes(scene: Scene, active: ActiveActorTensors, part: RayBatch, traced: SegmentTrace, passes: set[str]) -> Maps:
    """One array (N, ...) for each pass asked for, of rays that were traced."""
    maps: Maps = {}
    solid = traced.opacity > 0.5
    if passes & {"depth", "unsupported"}:
        depth = torch.where(solid, median_depth(scene.model, traced), torch.inf)
    if "depth" in passes:
        maps["depth"] = depth.cpu().numpy()
    if "opacity" in passes:
        maps["opacity"] = traced.opacity.cpu().numpy()
    if "instance" in passes:
        maps["instance"] = _instances(traced, len(part)).cpu().numpy()
    if "normal" in passes:
        maps["normal"] = _normals(scene, active, traced, part, solid).cpu().numpy()
    if "unsupported" in passes:
        maps["unsupported"] = (~_supported(scene, traced, part, depth)).cpu().numpy()
    return maps


def _instances(traced: SegmentTrace, rays: int) -> Tensor:
    """1 + the number of the actor with the largest weight on each ray (N,), 0 where the rest outweighs it."""
    best = traced.feature.new_zeros(rays)
    background = traced.transmittance_after.clone()
    actors = []
    for ray_segment in traced.ray_segments:
        assert ray_segment.weight is not None
        total = ray_segment.weight.sum(1)
        if ray_segment.bounds is None:
            background.index_add_(0, ray_segment.ray, total)
        else:
            actors.append((ray_segment, total))
            best.scatter_reduce_(0, ray_segment.ray, total, "amax")
    out = torch.zeros(rays, dtype=torch.long, device=best.device)
    for ray_segment, total in actors:
        heaviest = total == best[ray_segment.ray]
        # of several ray segments of one ray one order must decide: writing to one place by turns has none
        out.scatter_reduce_(0, ray_segment.ray[heaviest], ray_segment.field[heaviest] + 1, "amax")
    return torch.where(best > background, out, torch.zeros_like(out))


def _normals(scene: Scene, active: ActiveActorTensors, traced: SegmentTrace, part: RayBatch, solid: Tensor) -> Tensor:
    """Unit normals (N, 3), world frame, 0 where nothing solid is: each segment's gradient of the distance at its heaviest sample,
    by central differences on a tetrahedron, weighted with what the ray segment gives to the ray."""
    out = torch.zeros_like(part.directions)
    for ray_segment in traced.ray_segments:
        assert ray_segment.weight is not None
        weight, heaviest = ray_segment.weight.sum(1), ray_segment.weight.argmax(1)
        if ray_segment.normals is not None:
            out.index_add_(0, ray_segment.ray, weight[:, None] * ray_segment.normals)
            continue
        x = ray_segment.points[torch.arange(len(heaviest), device=heaviest.device), heaviest]
        gradient = distance_gradient(_distance_of(scene, active, ray_segment), x, NORMAL_STEP_M, ray_segment.size_m)
        if ray_segment.bounds is None:
            gradient = gradient @ scene.model.frame.rotation
        if ray_segment.world_from_box is not None:
            gradient = torch.einsum("nij,nj->ni", ray_segment.world_from_box, gradient)
        out.index_add_(0, ray_segment.ray, weight[:, None] * F.normalize(gradient, dim=-1))
    return torch.where(solid[:, None], F.normalize(out, dim=-1), torch.zeros_like(out))


def _distance_of(scene: Scene, active: ActiveActorTensors, ray_segment: RaySegments) -> Callable[[Tensor], Tensor]:
    """The signed distance in a segment's field, of points in its own coordinates, `CORNERS` for each row."""
    if ray_segment.bounds is None:
        return scene.model.static.distance
    actor_sets = [active.own, *active.foreign.values()]
    actor_set = actor_sets[ray_segment.foreign + 1]
    first = sum(len(t.uids) for t in actor_sets[: ray_segment.foreign + 1])
    row = actor_set.rows[ray_segment.field - first].repeat_interleave(CORNERS)
    return lambda y: actor_set.scene.actors.distance(actor_set.tables, y, row)


def _supported(scene: Scene, traced: SegmentTrace, part: RayBatch, depth_m: Tensor) -> Tensor:
    """Which rays (N,) end where the recording saw something: an observed voxel, an actor, or beyond the volume."""
    model = scene.model
    x = model.frame.points(part.origins + part.directions * torch.nan_to_num(depth_m, posinf=1e6)[:, None])
    outside = ((x < 0) | (x > model.frame.size_m)).any(-1)
    seen = model.observed.view(-1)[model.occupancy.cells(x)] > 0
    return outside | seen | (_instances(traced, len(part)) > 0)
