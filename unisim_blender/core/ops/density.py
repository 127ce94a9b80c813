"""From signed distances along a ray to weights.

Two densities of signed distances. ``logistic`` (the default; NeuS, Wang et al., 2021, eq. 13, for an interval between two
samples): ``1 - alpha = Phi(s2) / Phi(s1)`` with ``Phi(s) = sigmoid(beta s)``, so the optical depth of an interval is
``tau = max(0, softplus(-beta s2) - softplus(-beta s1))``. It telescopes: a surface's weight does not depend on the steps.
``unisim``: ``alpha = sigmoid(-beta s)`` a step of fixed length (UniSim, eq. 2), scaled to the interval's length.
``volume`` knows no distance: ``exp(-s)`` is the density itself (NeRF, Mildenhall et al., 2020, eq. 3; Mueller et al., 2022).

Everything stays in logs: ``1 - alpha`` is ``exp(-tau)``, ``alpha`` is ``-expm1(-tau)``, neither comes from a subtraction.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.nn.functional as F
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import native
from .constants import MAX_LOG_DENSITY
from .devices import kernel_threads
from .kernel_choice import kernels_for


def logistic_intervals_reference(s: Tensor, beta: Tensor | float) -> tuple[Tensor, Tensor]:
    """Optical depths tau (N, K) and stop fractions (N, K) of intervals between samples with signed distances s (N, K), metres.

    Interval k > 0 lies between samples k - 1 and k; interval 0 has no length and stands at sample 0: what a ray that starts
    behind a surface has already met. ``stop_fraction`` times alpha is the expected place of stopping inside the interval, from 0
    at its near end to 1 at its far one: with s linear in between, the integral of the transmittance is a difference of softplus.
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


class _LogisticIntervals(torch.autograd.Function):
    """The compiled intervals, forward and backward."""

    @staticmethod
    def forward(ctx: Any, s: Tensor, beta: Tensor) -> tuple[Tensor, Tensor]:
        lib = native.library()
        assert lib is not None
        s, sharp = s.contiguous(), float(beta)
        tau, stop_fraction = torch.empty_like(s), torch.empty_like(s)
        lib.unisim_intervals_forward(
            s.data_ptr(), *s.shape, sharp, tau.data_ptr(), stop_fraction.data_ptr(), kernel_threads()
        )  # fmt: skip
        ctx.sharp = sharp
        ctx.save_for_backward(s)
        return tau, stop_fraction

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[Tensor, Tensor]:
        lib = native.library()
        assert lib is not None
        (s,) = ctx.saved_tensors
        of_tau, of_stop_fraction = (g.contiguous() for g in grads)
        of_s, of_beta = torch.empty_like(s), torch.empty(())
        lib.unisim_intervals_backward(
            s.data_ptr(), *s.shape, ctx.sharp, of_tau.data_ptr(), of_stop_fraction.data_ptr(), of_s.data_ptr(),
            of_beta.data_ptr(), kernel_threads(),
        )  # fmt: skip
        return of_s, of_beta


def logistic_intervals(s: Tensor, beta: Tensor | float) -> tuple[Tensor, Tensor]:
    """`logistic_intervals_reference`, by the compiled kernels where they apply."""
    if kernels_for(s) != "compiled":
        return logistic_intervals_reference(s, beta)
    tau, stop_fraction = _LogisticIntervals.apply(s, torch.as_tensor(beta))  # type: ignore[no-untyped-call]
    return tau, stop_fraction


def unisim_intervals(s: Tensor, t: Tensor, beta: Tensor | float, step_m: float) -> tuple[Tensor, Tensor]:
    """The paper's density at the same intervals: tau (N, K), share (N, K) with all of an interval's weight at its far sample.

    Interval 0 is one step that ends at sample 0; as in `logistic_intervals` it stands at that sample and its share is 0.
    """
    per_step = F.softplus(-beta * s)  # -log(1 - sigmoid(-beta s))
    length = torch.diff(t, dim=1, prepend=t[:, :1] - step_m) / step_m
    tau = per_step * length
    alpha = -torch.expm1(-tau)
    return tau, torch.cat([torch.zeros_like(alpha[:, :1]), alpha[:, 1:]], -1)


def volume_intervals(s: Tensor, length_m: Tensor) -> tuple[Tensor, Tensor]:
    """Optical depths tau (N, K) of densities exp(-s), s (N, K), over lengths (N, K) in metres, and shares (N, K) with all of an
    interval's weight at its far sample; interval 0 stands at sample 0 and its share is 0."""
    tau = volume_density(s) * length_m
    alpha = -torch.expm1(-tau)
    return tau, torch.cat([torch.zeros_like(alpha[:, :1]), alpha[:, 1:]], -1)


def volume_density(s: Tensor) -> Tensor:
    """exp(-s), in 1 / metres, bounded."""
    return torch.exp((-s).clamp_max(MAX_LOG_DENSITY))


def weights_from_tau(tau: Tensor) -> tuple[Tensor, Tensor]:
    """Transmittances in front of each interval (N, K) and behind the last (N,), of optical depths in depth order (N, K)."""
    total = torch.cumsum(tau, -1)
    # shifted, for total - tau would lose what a thin interval before a dense one has taken away
    before = torch.cat([torch.zeros_like(total[:, :1]), total[:, :-1]], -1)
    return torch.exp(-before), torch.exp(-total[:, -1])
