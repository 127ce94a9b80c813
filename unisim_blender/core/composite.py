"""Strands of many media into one order of depth along each ray: transmittances, weights, features, depths.

Densities of overlapping media add and their features mix by weight, so the order in which strands come does not matter.
"""

from __future__ import annotations

import torch
from torch import Tensor

from .density import weights_from_tau
from .strands import Strands, Traced


def composite(rays: int, strands: list[Strands], width: int, guests: list[int], like: Tensor) -> Traced:
    """Everything on each ray in order of depth; ``width`` and ``guests`` are the lengths of the own and the guests' features."""
    feature, depth, total, log_behind = like.new_zeros(rays, width), *(like.new_zeros(rays) for _ in range(3))
    guest_features = [like.new_zeros(rays, own) for own in guests]
    guest_opacity = [like.new_zeros(rays) for _ in guests]
    for strand, front in zip(strands, _transmittances(rays, strands), strict=True):
        strand.front = front
        strand.interval_weight = front * -torch.expm1(-strand.tau)
        far_part = front * strand.share
        near_part = strand.interval_weight - far_part
        # an interval's weight goes to the samples at its two ends; interval 0 has only its own
        weight = far_part + torch.cat([near_part[:, 1:], torch.zeros_like(near_part[:, :1])], -1)
        weight = torch.cat([weight[:, :1] + strand.interval_weight[:, :1], weight[:, 1:]], -1)
        strand.weight = weight
        part, share = (weight[..., None] * strand.features).sum(1), weight.sum(1)
        if strand.guest < 0:
            feature = feature.index_add(0, strand.ray, part)
        else:
            guest_features[strand.guest] = guest_features[strand.guest].index_add(0, strand.ray, part)
            guest_opacity[strand.guest] = guest_opacity[strand.guest].index_add(0, strand.ray, share)
        depth = depth.index_add(0, strand.ray, (weight * strand.t).sum(1))
        total = total.index_add(0, strand.ray, share)
        log_behind = log_behind.index_add(0, strand.ray, -strand.tau.sum(1))
    depth, opacity = depth / total.clamp_min(1e-6), -torch.expm1(log_behind)
    return Traced(
        feature=feature, depth_m=depth, opacity=opacity, behind=torch.exp(log_behind), strands=strands, samples=0,
        guest_features=guest_features, guest_opacity=guest_opacity, near_depth_m=depth, near_opacity=opacity,
    )  # fmt: skip


def _transmittances(rays: int, strands: list[Strands]) -> list[Tensor]:
    """The transmittance in front of every interval (P, K) of each group of strands, all media of a ray in one order of depth."""
    if not strands:
        return []
    out = [weights_from_tau(strand.tau)[0] for strand in strands]
    all_rays = torch.cat([s.ray for s in strands])
    crossed = torch.bincount(all_rays, minlength=rays) > 1
    if not bool(crossed.any()):
        return out
    device = all_rays.device
    mixed_ray = torch.cumsum(crossed, 0) - 1
    # every ray with several strands gets a row, every strand of it a slot in the row
    order = torch.argsort(all_rays, stable=True)
    _, counts = torch.unique_consecutive(all_rays[order], return_counts=True)
    starts = torch.cumsum(counts, 0) - counts
    slot = torch.empty_like(all_rays)
    slot[order] = torch.arange(len(all_rays), device=device) - starts.repeat_interleave(counts)
    slots, longest = int(counts.max()), max(s.t.shape[1] for s in strands)
    rows = int(crossed.sum())
    tau = strands[0].t.new_zeros(rows * slots, longest)
    place = strands[0].t.new_full((rows * slots, longest), float("inf"))
    at, begin = [], 0
    for strand in strands:
        mine = torch.nonzero(crossed[strand.ray])[:, 0]
        cell = mixed_ray[strand.ray[mine]] * slots + slot[begin : begin + len(strand.ray)][mine]
        begin += len(strand.ray)
        at.append((mine, cell))
        pad = (0, longest - strand.t.shape[1])
        tau = tau.index_put((cell,), torch.nn.functional.pad(strand.tau[mine], pad))
        place = place.index_put((cell,), torch.nn.functional.pad(strand.stops().detach()[mine], pad, value=float("inf")))
    tau, place = tau.view(rows, -1), place.view(rows, -1)
    by_depth = torch.argsort(place, dim=1, stable=True)
    front, _ = weights_from_tau(tau.gather(1, by_depth))
    front = torch.zeros_like(front).scatter(1, by_depth, front).view(rows * slots, longest)
    return [own.index_put((mine,), front[cell][:, : own.shape[1]]) for own, (mine, cell) in zip(out, at, strict=True)]
