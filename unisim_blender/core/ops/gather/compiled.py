"""Weights and sums of ray segments, by the compiled kernels."""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ... import native
from ..devices import kernel_threads
from ..ray_segments import RaySegments
from ..transmittances.compiled import segments_struct
from .rows import with_even_rows


def gather(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """See `gather.gather`."""
    out: tuple[Tensor, Tensor, Tensor] = _Gather.apply(  # type: ignore[no-untyped-call]
        ray_segment.ray, ray_segment.t, ray_segment.tau, ray_segment.stop_fraction, before, ray_segment.features
    )
    return out


class _Gather(torch.autograd.Function):
    """Forward and backward."""

    @staticmethod
    def forward(
        ctx: Any, ray: Tensor, t: Tensor, tau: Tensor, stop_fraction: Tensor, before: Tensor, features: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        lib = native.library()
        assert lib is not None
        ray, t, tau, stop_fraction, before = (x.contiguous() for x in (ray, t, tau, stop_fraction, before))
        features = with_even_rows(features)
        n, _, length = features.shape
        interval, weight, sums = torch.empty_like(tau), torch.empty_like(tau), tau.new_empty(n, length + 3)
        lib.unisim_gather_forward(
            ctypes.byref(segments_struct(ray, t, tau, stop_fraction)), before.data_ptr(), features.data_ptr(),
            features.stride(1),
            length, interval.data_ptr(), weight.data_ptr(), sums.data_ptr(), kernel_threads(),
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
            ctypes.byref(segments_struct(ray, t, tau, stop_fraction)), before.data_ptr(), features.data_ptr(),
            features.stride(1),
            features.shape[2], weight.data_ptr(), of_interval.data_ptr(), of_weight.data_ptr(), of_sums.data_ptr(),
            of_tau.data_ptr(), of_stop_fraction.data_ptr(), of_before.data_ptr(), of_features.data_ptr(),
            kernel_threads(),
        )  # fmt: skip
        return None, None, of_tau, of_stop_fraction, of_before, of_features
