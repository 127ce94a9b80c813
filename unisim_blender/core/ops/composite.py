"""Ray segments of many fields into one order of depth along each ray: transmittances, weights, features, depths.

Densities of overlapping fields add and their features mix by weight, so the order in which ray segments come does not matter.
"""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import native
from .density import weights_from_tau
from .devices import kernel_threads
from .kernel_choice import kernels_for
from .ray_segments import RaySegments, SegmentTrace


def composite(rays: int, ray_segments: list[RaySegments], width: int, foreign: list[int], like: Tensor) -> SegmentTrace:
    """Everything on each ray in order of depth; ``width`` and ``foreign`` are the lengths of the own and the foreign sets'
    features."""
    feature, sums = like.new_zeros(rays, width), like.new_zeros(rays, 3)
    foreign_features = [like.new_zeros(rays, own) for own in foreign]
    foreign_opacity = [like.new_zeros(rays) for _ in foreign]
    for ray_segment, before in zip(ray_segments, transmittances(rays, ray_segments), strict=True):
        ray_segment.transmittance_before = before
        ray_segment.interval_weight, ray_segment.weight, given = gather(ray_segment, before)
        part, rest = given.split((ray_segment.features.shape[-1], 3), 1)
        if ray_segment.foreign < 0:
            feature = feature.index_add(0, ray_segment.ray, part)
        else:
            foreign_features[ray_segment.foreign] = foreign_features[ray_segment.foreign].index_add(0, ray_segment.ray, part)
            foreign_opacity[ray_segment.foreign] = foreign_opacity[ray_segment.foreign].index_add(0, ray_segment.ray, rest[:, 0])
        sums = sums.index_add(0, ray_segment.ray, rest)
    total, depth, tau = sums.unbind(1)
    depth, opacity = depth / total.clamp_min(1e-6), -torch.expm1(-tau)
    return SegmentTrace(
        feature=feature, depth_m=depth, opacity=opacity, transmittance_after=torch.exp(-tau), ray_segments=ray_segments,
        samples=0, foreign_features=foreign_features, foreign_opacity=foreign_opacity, near_depth_m=depth, near_opacity=opacity,
    )  # fmt: skip


def gather_reference(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weights of the intervals and of the samples (P, K) of ray segments with transmittances ``before`` (P, K), and what they
    give (P, F + 3): features by weight, the weight, distance by weight, optical depth."""
    interval = before * -torch.expm1(-ray_segment.tau)
    far_part = before * ray_segment.stop_fraction
    near_part = interval - far_part
    # an interval's weight goes to the samples at its two ends; interval 0 has only its own
    weight = far_part + torch.cat([near_part[:, 1:], torch.zeros_like(near_part[:, :1])], -1)
    weight = torch.cat([weight[:, :1] + interval[:, :1], weight[:, 1:]], -1)
    sums = [weight.sum(1), (weight * ray_segment.t).sum(1), ray_segment.tau.sum(1)]
    return interval, weight, torch.cat([(weight[..., None] * ray_segment.features).sum(1), torch.stack(sums, 1)], 1)


def gather(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`gather_reference`, by the compiled kernels or Triton's where they apply."""
    kernels = _kernels_for([ray_segment])
    if kernels == "triton":
        on_gpu: tuple[Tensor, Tensor, Tensor] = _GatherOnGpu.apply(  # type: ignore[no-untyped-call]
            ray_segment.t, ray_segment.tau, ray_segment.stop_fraction, before, ray_segment.features
        )
        return on_gpu
    if kernels is None:
        return gather_reference(ray_segment, before)
    out: tuple[Tensor, Tensor, Tensor] = _Gather.apply(  # type: ignore[no-untyped-call]
        ray_segment.ray, ray_segment.t, ray_segment.tau, ray_segment.stop_fraction, before, ray_segment.features
    )
    return out


def transmittances(rays: int, ray_segments: list[RaySegments]) -> list[Tensor]:
    """`transmittances_reference`, by the compiled kernels where they apply."""
    if not ray_segments or _kernels_for(ray_segments) != "compiled":
        return transmittances_reference(rays, ray_segments)
    order = [(s.ray, s.t, s.stop_fraction.detach()) for s in ray_segments]
    return list(_Transmittances.apply(rays, order, *(s.tau for s in ray_segments)))  # type: ignore[no-untyped-call]


def _kernels_for(ray_segments: list[RaySegments]) -> str | None:
    """The kernels that take these ray segments, see `kernels_for`: none where their places are learnt."""
    if any(s.t.requires_grad for s in ray_segments):
        return None
    return kernels_for(*(x for s in ray_segments for x in (s.t, s.tau, s.stop_fraction, s.features)))


def _struct(ray: Tensor, t: Tensor, tau: Tensor, stop_fraction: Tensor) -> native.RaySegmentsStruct:
    """Contiguous ray (P,) int64, t, tau and stop_fraction (P, K) in the form that the kernels read."""
    return native.RaySegmentsStruct(len(t), t.shape[1], *(x.data_ptr() for x in (ray, t, tau, stop_fraction)))


def _pointers(tensors: list[Tensor]) -> Any:
    return (ctypes.c_void_p * len(tensors))(*(x.data_ptr() for x in tensors))


class _Transmittances(torch.autograd.Function):
    """The compiled transmittances, forward and backward; the order of depth is held."""

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
        structs = (native.RaySegmentsStruct * len(taus))(*(_struct(*ray_segment) for ray_segment in ctx.ray_segments))
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
        structs = (native.RaySegmentsStruct * len(before))(*(_struct(*ray_segment) for ray_segment in ctx.ray_segments))
        lib.unisim_transmittances_backward(
            structs, len(before), ctx.rays, _pointers(before), _pointers(of_before), _pointers(of_tau), kernel_threads()
        )  # fmt: skip
        return None, None, *of_tau


class _Gather(torch.autograd.Function):
    """The compiled weights and sums of ray segments, forward and backward."""

    @staticmethod
    def forward(
        ctx: Any, ray: Tensor, t: Tensor, tau: Tensor, stop_fraction: Tensor, before: Tensor, features: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        lib = native.library()
        assert lib is not None
        ray, t, tau, stop_fraction, before = (x.contiguous() for x in (ray, t, tau, stop_fraction, before))
        features = _rows_alone(features)
        n, _, length = features.shape
        interval, weight, sums = torch.empty_like(tau), torch.empty_like(tau), tau.new_empty(n, length + 3)
        lib.unisim_gather_forward(
            ctypes.byref(_struct(ray, t, tau, stop_fraction)), before.data_ptr(), features.data_ptr(), features.stride(1), length,
            interval.data_ptr(), weight.data_ptr(), sums.data_ptr(), kernel_threads(),
        )  # fmt: skip
        ctx.save_for_backward(ray, t, tau, stop_fraction, before, features, weight)
        return interval, weight, sums

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        lib = native.library()
        assert lib is not None
        ray, t, tau, stop_fraction, before, features, weight = ctx.saved_tensors
        of_interval, of_weight, of_sums = (g.contiguous() for g in grads)
        of_tau, of_stop_fraction, of_before = (torch.empty_like(tau) for _ in range(3))
        of_features = features.new_empty(features.shape)
        lib.unisim_gather_backward(
            ctypes.byref(_struct(ray, t, tau, stop_fraction)), before.data_ptr(), features.data_ptr(), features.stride(1),
            features.shape[2], weight.data_ptr(), of_interval.data_ptr(), of_weight.data_ptr(), of_sums.data_ptr(),
            of_tau.data_ptr(), of_stop_fraction.data_ptr(), of_before.data_ptr(), of_features.data_ptr(), kernel_threads(),
        )  # fmt: skip
        return None, None, of_tau, of_stop_fraction, of_before, of_features


class _GatherOnGpu(torch.autograd.Function):
    """Triton's weights and sums of ray segments, forward and backward."""

    @staticmethod
    def forward(
        ctx: Any, t: Tensor, tau: Tensor, stop_fraction: Tensor, before: Tensor, features: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        from .triton.gather import gather_forward

        t, tau, stop_fraction, before = (x.contiguous() for x in (t, tau, stop_fraction, before))
        features = _rows_alone(features)
        interval, weight, sums = gather_forward(t, tau, stop_fraction, before, features)
        ctx.save_for_backward(t, tau, stop_fraction, before, features, weight)
        return interval, weight, sums

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        from .triton.gather import gather_backward

        return None, *gather_backward(*ctx.saved_tensors, *(g.contiguous() for g in grads))


def _rows_alone(features: Tensor) -> Tensor:
    """Features (P, K, F) whose rows are even: they may be columns of what a network gave, so rows need not touch."""
    n, width, _ = features.shape
    if n * width and (features.stride(2) != 1 or features.stride(0) != width * features.stride(1)):
        return features.contiguous()
    return features


def transmittances_reference(rays: int, ray_segments: list[RaySegments]) -> list[Tensor]:
    """The transmittance before every interval (P, K) of each group of ray segments, all fields of a ray in one order of
    depth."""
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
        place = place.index_put((cell,), torch.nn.functional.pad(ray_segment.stops().detach()[mine], pad, value=float("inf")))
    tau, place = tau.view(rows, -1), place.view(rows, -1)
    by_depth = torch.argsort(place, dim=1, stable=True)
    before, _ = weights_from_tau(tau.gather(1, by_depth))
    before = torch.zeros_like(before).scatter(1, by_depth, before).view(rows * slots, longest)
    return [own.index_put((mine,), before[cell][:, : own.shape[1]]) for own, (mine, cell) in zip(out, at, strict=True)]
