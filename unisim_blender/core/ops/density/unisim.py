"""UniSim's density of signed distances: ``alpha = sigmoid(-beta s)`` a step of fixed length (Yang et al., 2023, eq.
2), scaled to an interval's length."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor


def unisim_intervals(s: Tensor, t: Tensor, beta: Tensor | float, step_m: float) -> tuple[Tensor, Tensor]:
    """The paper's density at the same intervals: tau (N, K), stop fractions (N, K) with all of an interval's weight
    at its far sample.

    Interval 0 is one step that ends at sample 0; as in `logistic_intervals` it stands at that sample and its stop
    fraction is 0.
    """
    per_step = F.softplus(-beta * s)  # -log(1 - sigmoid(-beta s))
    length = torch.diff(t, dim=1, prepend=t[:, :1] - step_m) / step_m
    tau = per_step * length
    alpha = -torch.expm1(-tau)
    return tau, torch.cat([torch.zeros_like(alpha[:, :1]), alpha[:, 1:]], -1)
