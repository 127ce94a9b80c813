"""Transmittances before the intervals of each ray, through the ray segments of all fields in one order of depth."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import native
from .devices import kernel_threads
from .dispatch import Operation
from .ray_segments import RaySegments


def transmittances(rays: int, ray_segments: Sequence[RaySegments]) -> list[Tensor]:
    """Return the transmittances (P, K) before the intervals of each group of ray segments, with all fields of a ray in
    one order of depth."""
    return OPERATION(rays, ray_segments)


def weights_from_tau(tau: Tensor) -> tuple[Tensor, Tensor]:
    """Return the transmittances before each interval (N, K) and after the last (N,) of optical depths (N, K) in depth
    order."""
    total = torch.cumsum(tau, -1)
    # shifted, for total - tau would lose what a thin interval before a dense one has taken away
    before = torch.cat([torch.zeros_like(total[:, :1]), total[:, :-1]], -1)
    return torch.exp(-before), torch.exp(-total[:, -1])


def transmittances_reference(rays: int, ray_segments: Sequence[RaySegments]) -> list[Tensor]:
    """`transmittances` in plain torch: rays with several ray segments are sorted by depth."""
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


def transmittances_padded(rays: int, ray_segments: Sequence[RaySegments]) -> list[Tensor]:
    """`transmittances` in plain torch with shapes that depend on no value: all intervals are sorted by ray, then depth."""
    tau = torch.cat([s.tau.flatten() for s in ray_segments])
    place = torch.cat([s.stops().detach().flatten() for s in ray_segments])
    ray = torch.cat([s.ray[:, None].expand_as(s.tau).flatten() for s in ray_segments])
    order = torch.argsort(place, stable=True)
    order = order[torch.argsort(ray[order], stable=True)]
    # one sum along all rays: float64 keeps a ray's own where those before it are taken off
    total = F.pad(tau[order].double().cumsum(0), (1, 0))
    ordered = ray[order]
    before = total[:-1] - total[torch.searchsorted(ordered, ordered)]
    back = torch.empty_like(order).scatter_(0, order, torch.arange(len(order), device=order.device))
    parts = torch.exp(-before.to(tau.dtype))[back].split([s.tau.numel() for s in ray_segments])
    return [part.view_as(s.tau) for part, s in zip(parts, ray_segments, strict=True)]


def transmittances_compiled(rays: int, ray_segments: Sequence[RaySegments]) -> list[Tensor]:
    """`transmittances` by the compiled kernels; the order of depth has no gradient."""
    order = [(s.ray, s.t, s.stop_fraction.detach()) for s in ray_segments]
    return list(_Transmittances.apply(rays, order, *(s.tau for s in ray_segments)))  # type: ignore[no-untyped-call]


def segments_struct(ray: Tensor, t: Tensor, tau: Tensor, stop_fraction: Tensor) -> native.RaySegmentsStruct:
    """Return contiguous ray (P,) int64, t, tau and stop_fraction (P, K) in the form that the kernels read."""
    return native.RaySegmentsStruct(len(t), t.shape[1], *(x.data_ptr() for x in (ray, t, tau, stop_fraction)))


def _pointers(tensors: list[Tensor]) -> Any:
    return (ctypes.c_void_p * len(tensors))(*(x.data_ptr() for x in tensors))


class _Transmittances(torch.autograd.Function):
    """Forward and backward."""

    @staticmethod
    def forward(ctx: Any, rays: int, order: list[tuple[Tensor, Tensor, Tensor]], *taus: Tensor) -> tuple[Tensor, ...]:
        lib = native.library()
        assert lib is not None
        ctx.rays = rays
        ctx.ray_segments = [
            tuple(x.contiguous() for x in (ray, t, tau.detach(), stop_fraction))
            for (ray, t, stop_fraction), tau in zip(order, taus, strict=True)
        ]
        before = [torch.empty_like(tau, memory_format=torch.contiguous_format) for tau in taus]
        structs = (native.RaySegmentsStruct * len(taus))(
            *(segments_struct(*ray_segment) for ray_segment in ctx.ray_segments)
        )
        lib.unisim_transmittances_forward(structs, len(taus), rays, _pointers(before), kernel_threads())
        ctx.save_for_backward(*before)
        return tuple(before)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        lib = native.library()
        assert lib is not None
        before, of_before = list(ctx.saved_tensors), [g.contiguous() for g in grads]
        of_tau = [torch.empty_like(f) for f in before]
        structs = (native.RaySegmentsStruct * len(before))(
            *(segments_struct(*ray_segment) for ray_segment in ctx.ray_segments)
        )
        lib.unisim_transmittances_backward(
            structs, len(before), ctx.rays, _pointers(before), _pointers(of_before), _pointers(of_tau), kernel_threads()
        )  # fmt: skip
        return None, None, *of_tau


def _deciding(rays: int, ray_segments: Sequence[RaySegments]) -> Sequence[Tensor]:
    # kernels have no gradient of places
    if any(s.t.requires_grad for s in ray_segments):
        return ()
    return [x for s in ray_segments for x in (s.t, s.tau, s.stop_fraction, s.features)]


OPERATION = Operation(transmittances_reference, _deciding, compiled=transmittances_compiled)
