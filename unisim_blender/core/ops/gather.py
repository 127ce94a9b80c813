"""Weights of the samples along ray segments, and the sums by weight that each segment adds to its ray."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import native
from . import gpu
from .devices import kernel_threads
from .dispatch import Operation, on_cpu_or_gpu
from .ray_segments import RaySegments
from .transmittances import segments_struct


def gather(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Return the weights of the intervals (P, K) and of the samples (P, K) of ray segments with transmittances
    ``before`` (P, K), and each segment's sums (P, F + 3): features by weight, the weight, distance by weight, optical
    depth."""
    assert before.shape == ray_segment.tau.shape, (before.shape, ray_segment.tau.shape)
    return OPERATION(ray_segment, before)


def gather_reference(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`gather` in plain torch."""
    interval = before * -torch.expm1(-ray_segment.tau)
    far_part = before * ray_segment.stop_fraction
    near_part = interval - far_part
    # an interval's weight goes to the samples at its two ends; interval 0 has only its own
    weight = far_part + torch.cat([near_part[:, 1:], torch.zeros_like(near_part[:, :1])], -1)
    weight = torch.cat([weight[:, :1] + interval[:, :1], weight[:, 1:]], -1)
    sums = [weight.sum(1), (weight * ray_segment.t).sum(1), ray_segment.tau.sum(1)]
    return interval, weight, torch.cat([(weight[..., None] * ray_segment.features).sum(1), torch.stack(sums, 1)], 1)


def gather_compiled(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """`gather` by the compiled kernels."""
    out: tuple[Tensor, Tensor, Tensor] = _Gather.apply(  # type: ignore[no-untyped-call]
        ray_segment.ray, ray_segment.t, ray_segment.tau, ray_segment.stop_fraction, before, ray_segment.features
    )
    return out


def with_even_rows(features: Tensor) -> Tensor:
    """Return features (P, K, F) with a constant stride of rows: columns of a network's output have rows that do not
    touch."""
    n, width, _ = features.shape
    if n * width and (features.stride(2) != 1 or features.stride(0) != width * features.stride(1)):
        return features.contiguous()
    return features


def _segments(
    t: Tensor, tau: Tensor, stop_fraction: Tensor, before: Tensor, features: Tensor
) -> gpu.GatheredSegmentsStruct:
    n, width, length = features.shape
    values = (x.data_ptr() for x in (t, tau, stop_fraction, before, features))
    return gpu.GatheredSegmentsStruct(n, features.stride(1), width, length, *values)


class _Gather(torch.autograd.Function):
    """Forward and backward."""

    @staticmethod
    def forward(
        ctx: Any, ray: Tensor, t: Tensor, tau: Tensor, stop_fraction: Tensor, before: Tensor, features: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        ray, t, tau, stop_fraction, before = (x.contiguous() for x in (ray, t, tau, stop_fraction, before))
        features = with_even_rows(features)
        n, _, length = features.shape
        interval, weight, sums = torch.empty_like(tau), torch.empty_like(tau), tau.new_empty(n, length + 3)
        ctx.save_for_backward(ray, t, tau, stop_fraction, before, features, weight)
        if gpu.serves(tau):
            of = _segments(t, tau, stop_fraction, before, features)
            gpu.launch("weigh", tau, n, of, interval, weight, sums)
            gpu.launch("sum_features", tau, n * length, of, weight, sums)
            return interval, weight, sums
        lib = native.library()
        assert lib is not None
        lib.unisim_gather_forward(
            ctypes.byref(segments_struct(ray, t, tau, stop_fraction)), before.data_ptr(), features.data_ptr(),
            features.stride(1),
            length, interval.data_ptr(), weight.data_ptr(), sums.data_ptr(), kernel_threads(),
        )  # fmt: skip
        return interval, weight, sums

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        ray, t, tau, stop_fraction, before, features, weight = ctx.saved_tensors
        of_interval, of_weight, of_sums = (g.contiguous() for g in grads)
        of_tau, of_stop_fraction, of_before = (torch.empty_like(tau) for _ in range(3))
        of_features = features.new_empty(features.shape)
        if gpu.serves(tau):
            of = _segments(t, tau, stop_fraction, before, features)
            gpu.launch("weight_gradients", tau, tau.numel(), of, of_weight, of_sums, of_before)
            gpu.launch("gather_gradients", tau, len(tau), of, of_interval, of_sums, of_tau, of_stop_fraction, of_before)
            gpu.launch("feature_gradients", tau, of_features.numel(), of, weight, of_sums, of_features)
            return None, None, of_tau, of_stop_fraction, of_before, of_features
        lib = native.library()
        assert lib is not None
        lib.unisim_gather_backward(
            ctypes.byref(segments_struct(ray, t, tau, stop_fraction)), before.data_ptr(), features.data_ptr(),
            features.stride(1),
            features.shape[2], weight.data_ptr(), of_interval.data_ptr(), of_weight.data_ptr(), of_sums.data_ptr(),
            of_tau.data_ptr(), of_stop_fraction.data_ptr(), of_before.data_ptr(), of_features.data_ptr(),
            kernel_threads(),
        )  # fmt: skip
        return None, None, of_tau, of_stop_fraction, of_before, of_features


def _deciding(ray_segment: RaySegments, before: Tensor) -> Sequence[Tensor]:
    # kernels have no gradient of places
    if ray_segment.t.requires_grad:
        return ()
    return ray_segment.t, ray_segment.tau, ray_segment.stop_fraction, ray_segment.features


OPERATION = Operation(gather_reference, _deciding, compiled=gather_compiled, takes=on_cpu_or_gpu)
