"""Optical depths of the intervals between samples along a ray, from the values of a field there.

Signed distances have two densities: the logistic one, which is the default and has kernels, and UniSim's (Yang et al.,
2023, eq. 2). Fields of log densities are as in NeRF (Mildenhall et al., 2020, eq. 3; Mueller et al., 2022). Each
function returns optical depths tau (N, K) and stop fractions (N, K), float; interval k > 0 lies between samples k - 1
and k.
"""

from __future__ import annotations

import ctypes
from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import native
from . import gpu
from .constants import MAX_LOG_DENSITY
from .devices import kernel_threads
from .dispatch import Operation, on_cpu_or_gpu


def logistic_intervals(s: Tensor, beta: Tensor | float) -> tuple[Tensor, Tensor]:
    """Return optical depths tau (N, K) and stop fractions (N, K) of intervals between samples with signed distances s
    (N, K), metres, and the sharpness ``beta``, 1 / metres.

    Interval k > 0 lies between samples k - 1 and k; interval 0 has no length and stands at sample 0: what a ray that
    starts behind a surface has already hit. ``stop_fraction`` times alpha is the expected place of stopping inside
    the interval, from 0 at its near end to 1 at its far one.
    """
    return OPERATION(s, beta)


def logistic_intervals_reference(s: Tensor, beta: Tensor | float) -> tuple[Tensor, Tensor]:
    """`logistic_intervals` in plain torch.

    ``1 - alpha = Phi(s2) / Phi(s1)`` with ``Phi(s) = sigmoid(beta s)`` (NeuS, Wang et al., 2021, eq. 13, for an
    interval between two samples), so the optical depth of an interval is ``tau = max(0, softplus(-beta s2) -
    softplus(-beta s1))``. It telescopes: a surface's weight does not depend on the steps. Everything stays in logs: ``1
    - alpha`` is ``exp(-tau)``, ``alpha`` is ``-expm1(-tau)``, neither comes from a subtraction. With s linear between
    the samples, the integral of the transmittance is a difference of softplus.
    """
    a = -beta * s
    outside = F.softplus(a)  # -log Phi
    tau0 = outside[:, :1]
    rise = outside[:, 1:] - outside[:, :-1]
    tau = rise.clamp_min(0.0)
    alpha = -torch.expm1(-tau)
    # mean transmittance over the interval; softplus(b s) = b s + softplus(-b s)
    slope = a[:, 1:] - a[:, :-1]
    flat, deep = slope.abs() < 1e-2, outside[:, :-1] > 5.0
    safe = torch.where(flat, torch.ones_like(slope), slope)
    mean = (slope - rise) / safe * torch.exp(outside[:, :-1].clamp_max(5.0))
    # behind the surface Phi is exp(-a) to 1 %, and the difference above would cancel
    mean = torch.where(deep, -torch.expm1(-safe.clamp_min(1e-2)) / safe.clamp_min(1e-2), mean)
    mean = torch.where(flat, 1 - alpha / 2, mean)
    stop_fraction = torch.minimum((mean - torch.exp(-tau)).clamp_min(0.0), alpha)
    return torch.cat([tau0, tau], -1), torch.cat([torch.zeros_like(tau0), stop_fraction], -1)


def logistic_intervals_compiled(s: Tensor, beta: Tensor | float) -> tuple[Tensor, Tensor]:
    """`logistic_intervals` by the compiled kernels."""
    tau, stop_fraction = _LogisticIntervals.apply(s, beta if isinstance(beta, Tensor) else s.new_full((), beta))  # type: ignore[no-untyped-call]
    return tau, stop_fraction


class _LogisticIntervals(torch.autograd.Function):
    """Forward and backward."""

    @staticmethod
    def forward(ctx: Any, s: Tensor, beta: Tensor) -> tuple[Tensor, Tensor]:
        s = s.contiguous()
        tau, stop_fraction = torch.empty_like(s), torch.empty_like(s)
        ctx.save_for_backward(s, beta)
        if gpu.serves(s):
            width = ctypes.c_int32(s.shape[1])
            gpu.launch("intervals", s, s.numel(), s, s.numel(), width, beta, tau, stop_fraction)
            return tau, stop_fraction
        lib = native.library()
        assert lib is not None
        ctx.sharp = sharp = float(beta)
        lib.unisim_intervals_forward(
            s.data_ptr(), *s.shape, sharp, tau.data_ptr(), stop_fraction.data_ptr(), kernel_threads()
        )  # fmt: skip
        return tau, stop_fraction

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:
        s, beta = ctx.saved_tensors
        of_tau, of_stop_fraction = (g.contiguous() for g in grads)
        of_s, of_beta = torch.empty_like(s), torch.empty_like(beta)
        if gpu.serves(s):
            width = ctypes.c_int32(s.shape[1])
            gpu.launch("interval_gradients", s, s.numel(), s, s.numel(), width, beta, of_tau, of_stop_fraction, of_s)
            return -beta * of_s, -(s * of_s).sum()
        lib = native.library()
        assert lib is not None
        lib.unisim_intervals_backward(
            s.data_ptr(), *s.shape, ctx.sharp, of_tau.data_ptr(), of_stop_fraction.data_ptr(), of_s.data_ptr(),
            of_beta.data_ptr(), kernel_threads(),
        )  # fmt: skip
        return of_s, of_beta


OPERATION = Operation(
    logistic_intervals_reference, lambda s, beta: (s,), compiled=logistic_intervals_compiled, takes=on_cpu_or_gpu
)


def unisim_intervals(s: Tensor, t: Tensor, beta: Tensor | float, step_m: float) -> tuple[Tensor, Tensor]:
    """Return optical depths tau (N, K) and stop fractions (N, K) by UniSim's density of signed distances s (N, K) at t
    (N, K), both metres: ``alpha = sigmoid(-beta s)`` for a step of ``step_m``, scaled to an interval's length, with all
    of an interval's weight at its far sample.

    Interval 0 is one step that ends at sample 0; as in `logistic_intervals` it stands at that sample and its stop
    fraction is 0.
    """
    assert s.shape == t.shape, (s.shape, t.shape)
    per_step = F.softplus(-beta * s)  # -log(1 - sigmoid(-beta s))
    length = torch.diff(t, dim=1, prepend=t[:, :1] - step_m) / step_m
    tau = per_step * length
    alpha = -torch.expm1(-tau)
    return tau, torch.cat([torch.zeros_like(alpha[:, :1]), alpha[:, 1:]], -1)


def volume_intervals(log_density: Tensor, length_m: Tensor) -> tuple[Tensor, Tensor]:
    """Return optical depths tau (N, K) of densities, logarithms (N, K) of 1 / metres, over lengths (N, K) in metres,
    and stop fractions (N, K) with all of an interval's weight at its far sample; interval 0 stands at sample 0 and its
    stop fraction is 0."""
    assert log_density.shape == length_m.shape, (log_density.shape, length_m.shape)
    tau = volume_density(log_density) * length_m
    alpha = -torch.expm1(-tau)
    return tau, torch.cat([torch.zeros_like(alpha[:, :1]), alpha[:, 1:]], -1)


def volume_density(log_density: Tensor) -> Tensor:
    """Return densities (...), 1 / metres, of their logarithms (...), at most exp(`MAX_LOG_DENSITY`)."""
    return torch.exp(log_density.clamp_max(MAX_LOG_DENSITY))
