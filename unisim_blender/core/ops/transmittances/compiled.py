"""Transmittances of ray segments of many fields, by the compiled kernels."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ... import native
from ..devices import kernel_threads
from ..ray_segments import RaySegments


def transmittances(rays: int, ray_segments: Sequence[RaySegments]) -> list[Tensor]:
    """See `transmittances.transmittances`; the order of depth is held."""
    order = [(s.ray, s.t, s.stop_fraction.detach()) for s in ray_segments]
    return list(_Transmittances.apply(rays, order, *(s.tau for s in ray_segments)))  # type: ignore[no-untyped-call]


def segments_struct(ray: Tensor, t: Tensor, tau: Tensor, stop_fraction: Tensor) -> native.RaySegmentsStruct:
    """Contiguous ray (P,) int64, t, tau and stop_fraction (P, K) in the form that the kernels read."""
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
