"""Weights of samples along ray segments and what they add up to, by Triton's kernels, forward and backward.

A program goes along BLOCK ray segments, interval by interval; what a ray segment gives stays with it until its end.
"""

from __future__ import annotations

from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..gather import with_even_rows
from ..ray_segments import RaySegments

BLOCK = 32


@triton.jit
def _stopped(tau):
    # 1 - exp(-tau), without what cancels where tau is small
    series = tau * (1 - tau / 2 * (1 - tau / 3 * (1 - tau / 4)))
    return tl.where(tau < 0.03, series, 1 - tl.exp(-tau))


@triton.jit
def _numbered(n, WIDTH: tl.constexpr, WIDE: tl.constexpr, BLOCK: tl.constexpr):
    # numbers of the program's ray segments and of features, which ray segments there are, and of which a feature
    p = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    f = tl.arange(0, WIDE)
    return p, f, p < n, (p < n)[:, None] & (f < WIDTH)[None, :]


# each value of a count would be compiled anew: for a 1, for multiples of 16, for all others
@triton.jit(do_not_specialize=["n", "count"])
def _forward(
    n, count, t, tau, stop_fraction, before, features, row, interval, weight, sums,
    WIDTH: tl.constexpr, WIDE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    p, f, there, mask = _numbered(n, WIDTH, WIDE, BLOCK)
    feature = tl.zeros((BLOCK, WIDE), tl.float32)
    of_weight, of_t, of_tau = (
        tl.zeros((BLOCK,), tl.float32),
        tl.zeros((BLOCK,), tl.float32),
        tl.zeros((BLOCK,), tl.float32),
    )
    near = tl.zeros((BLOCK,), tl.float32)
    for back in range(0, count):
        i = count - 1 - back
        at = p * count + i
        own_tau, own_before = tl.load(tau + at, mask=there, other=0.0), tl.load(before + at, mask=there, other=0.0)
        stops = own_before * _stopped(own_tau)
        far = own_before * tl.load(stop_fraction + at, mask=there, other=0.0)
        # an interval's weight goes to the samples at its two ends; interval 0 has only its own
        w = far + near + tl.where(i == 0, stops, 0.0)
        near = stops - far
        tl.store(interval + at, stops, mask=there)
        tl.store(weight + at, w, mask=there)
        of_weight += w
        of_t += w * tl.load(t + at, mask=there, other=0.0)
        of_tau += own_tau
        feature += w[:, None] * tl.load(features + at[:, None] * row + f[None, :], mask=mask, other=0.0)
    out = p * (WIDTH + 3)
    tl.store(sums + out[:, None] + f[None, :], feature, mask=mask)
    tl.store(sums + out + WIDTH, of_weight, mask=there)
    tl.store(sums + out + WIDTH + 1, of_t, mask=there)
    tl.store(sums + out + WIDTH + 2, of_tau, mask=there)


@triton.jit(do_not_specialize=["n", "count"])
def _backward(
    n, count, t, tau, stop_fraction, before, features, row, weight, g_interval,
    g_weight, g_sums, of_tau, of_stop_fraction, of_before, of_features,
    WIDTH: tl.constexpr, WIDE: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    p, f, there, mask = _numbered(n, WIDTH, WIDE, BLOCK)
    given = p * (WIDTH + 3)
    g_feature = tl.load(g_sums + given[:, None] + f[None, :], mask=mask, other=0.0)
    g_total = tl.load(g_sums + given + WIDTH, mask=there, other=0.0)
    g_t = tl.load(g_sums + given + WIDTH + 1, mask=there, other=0.0)
    g_tau = tl.load(g_sums + given + WIDTH + 2, mask=there, other=0.0)
    last = tl.zeros((BLOCK,), tl.float32)
    for i in range(0, count):
        at = p * count + i
        w = tl.load(weight + at, mask=there, other=0.0)
        feature = tl.load(features + at[:, None] * row + f[None, :], mask=mask, other=0.0)
        tl.store(of_features + at[:, None] * WIDTH + f[None, :], w[:, None] * g_feature, mask=mask)
        g_w = tl.load(g_weight + at, mask=there, other=0.0) + tl.sum(g_feature * feature, 1)
        g_w += g_total + g_t * tl.load(t + at, mask=there, other=0.0)
        # the far part is this sample's, the near part the one before's; of interval 0 this one has all
        near = tl.where(i == 0, g_w, last)
        own_tau, own_before = tl.load(tau + at, mask=there, other=0.0), tl.load(before + at, mask=there, other=0.0)
        own_stop_fraction = tl.load(stop_fraction + at, mask=there, other=0.0)
        g_stops = tl.load(g_interval + at, mask=there, other=0.0) + near
        g_far = g_w - tl.where(i == 0, 0.0, last)
        tl.store(of_tau + at, g_stops * own_before * tl.exp(-own_tau) + g_tau, mask=there)
        tl.store(of_stop_fraction + at, g_far * own_before, mask=there)
        tl.store(of_before + at, g_stops * _stopped(own_tau) + g_far * own_stop_fraction, mask=there)
        last = g_w


def _gather_forward(
    t: Tensor, tau: Tensor, stop_fraction: Tensor, before: Tensor, features: Tensor
) -> tuple[Tensor, Tensor, Tensor]:
    """Weights of intervals and samples (P, K) and sums (P, F + 3), of contiguous t, tau, stop_fraction, before (P, K)
    and features (P, K, F), whose rows need not touch."""
    n, count, width = features.shape
    interval, weight, sums = torch.empty_like(tau), torch.empty_like(tau), tau.new_empty(n, width + 3)
    if n:
        with torch.cuda.device_of(tau):
            _forward[(triton.cdiv(n, BLOCK),)](
                n, count, t, tau, stop_fraction, before, features, features.stride(1), interval, weight, sums,
                WIDTH=width, WIDE=triton.next_power_of_2(width), BLOCK=BLOCK,
            )  # fmt: skip
    return interval, weight, sums


def _gather_backward(
    t: Tensor, tau: Tensor, stop_fraction: Tensor, before: Tensor, features: Tensor, weight: Tensor,
    of_interval: Tensor, of_weight: Tensor, of_sums: Tensor,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    """Gradients of tau, stop_fraction, before (P, K) and features (P, K, F), of those of what `_gather_forward` gave;
    ``weight`` is its."""
    n, count, width = features.shape
    g_tau, g_stop_fraction, g_before = (torch.empty_like(tau) for _ in range(3))
    g_features = features.new_empty(features.shape)
    if n:
        with torch.cuda.device_of(tau):
            _backward[(triton.cdiv(n, BLOCK),)](
                n, count, t, tau, stop_fraction, before, features, features.stride(1), weight, of_interval, of_weight,
                of_sums,
                g_tau, g_stop_fraction, g_before, g_features, WIDTH=width, WIDE=triton.next_power_of_2(width),
                BLOCK=BLOCK,
            )  # fmt: skip
    return g_tau, g_stop_fraction, g_before, g_features


class _Gather(torch.autograd.Function):
    """Forward and backward."""

    @staticmethod
    def forward(
        ctx: Any, t: Tensor, tau: Tensor, stop_fraction: Tensor, before: Tensor, features: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        t, tau, stop_fraction, before = (x.contiguous() for x in (t, tau, stop_fraction, before))
        features = with_even_rows(features)
        interval, weight, sums = _gather_forward(t, tau, stop_fraction, before, features)
        ctx.save_for_backward(t, tau, stop_fraction, before, features, weight)
        return interval, weight, sums

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor | None, ...]:
        return None, *_gather_backward(*ctx.saved_tensors, *(g.contiguous() for g in grads))


def gather(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """See `ops.gather.gather`."""
    out: tuple[Tensor, Tensor, Tensor] = _Gather.apply(
        ray_segment.t, ray_segment.tau, ray_segment.stop_fraction, before, ray_segment.features
    )
    return out
