"""Optical depths of the logistic density of signed distances, in plain torch.

``1 - alpha = Phi(s2) / Phi(s1)`` with ``Phi(s) = sigmoid(beta s)`` (NeuS, Wang et al., 2021, eq. 13, for an interval
between two samples), so the optical depth of an interval is ``tau = max(0, softplus(-beta s2) - softplus(-beta
s1))``. It telescopes: a surface's weight does not depend on the steps. Everything stays in logs: ``1 - alpha`` is
``exp(-tau)``, ``alpha`` is ``-expm1(-tau)``, neither comes from a subtraction.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def logistic_intervals(s: Tensor, beta: Tensor | float) -> tuple[Tensor, Tensor]:
    """Optical depths tau (N, K) and stop fractions (N, K) of intervals between samples with signed distances s (N,
    K), metres.

    Interval k > 0 lies between samples k - 1 and k; interval 0 has no length and stands at sample 0: what a ray that
    starts behind a surface has already hit. ``stop_fraction`` times alpha is the expected place of stopping inside
    the interval, from 0 at its near end to 1 at its far one: with s linear in between, the integral of the
    transmittance is a difference of softplus.
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
