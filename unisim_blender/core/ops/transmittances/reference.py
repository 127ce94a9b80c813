"""Transmittances of ray segments of many fields, in plain torch: rays with several ray segments are sorted by
depth."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..optical_depth import weights_from_tau
from ..ray_segments import RaySegments


def transmittances(rays: int, ray_segments: Sequence[RaySegments]) -> list[Tensor]:
    """The transmittance before every interval (P, K) of each group of ray segments, all fields of a ray in one order
    of depth."""
    if not ray_segments:
        return []
    out = [weights_from_tau(ray_segment.tau)[0] for ray_segment in ray_segments]
    all_rays = torch.cat([s.ray for s in ray_segments])
    crossed = torch.bincount(all_rays, minlength=rays) > 1
    if not bool(crossed.any()):
        return out
    device = all_rays.device
    mixed_ray = torch.cumsum(crossed, 0) - 1
    # every ray with several ray segments gets a row, every ray segment of it a slot in the row
    order = torch.argsort(all_rays, stable=True)
    _, counts = torch.unique_consecutive(all_rays[order], return_counts=True)
    starts = torch.cumsum(counts, 0) - counts
    slot = torch.empty_like(all_rays)
    slot[order] = torch.arange(len(all_rays), device=device) - starts.repeat_interleave(counts)
    slots, longest = int(counts.max()), max(s.t.shape[1] for s in ray_segments)
    rows = int(crossed.sum())
    tau = ray_segments[0].t.new_zeros(rows * slots, longest)
    place = ray_segments[0].t.new_full((rows * slots, longest), float("inf"))
    at, begin = [], 0
    for ray_segment in ray_segments:
        mine = torch.nonzero(crossed[ray_segment.ray])[:, 0]
        cell = mixed_ray[ray_segment.ray[mine]] * slots + slot[begin : begin + len(ray_segment.ray)][mine]
        begin += len(ray_segment.ray)
        at.append((mine, cell))
        pad = (0, longest - ray_segment.t.shape[1])
        tau = tau.index_put((cell,), torch.nn.functional.pad(ray_segment.tau[mine], pad))
        place = place.index_put(
            (cell,), torch.nn.functional.pad(ray_segment.stops().detach()[mine], pad, value=float("inf"))
        )
    tau, place = tau.view(rows, -1), place.view(rows, -1)
    by_depth = torch.argsort(place, dim=1, stable=True)
    before, _ = weights_from_tau(tau.gather(1, by_depth))
    before = torch.zeros_like(before).scatter(1, by_depth, before).view(rows * slots, longest)
    return [own.index_put((mine,), before[cell][:, : own.shape[1]]) for own, (mine, cell) in zip(out, at, strict=True)]
