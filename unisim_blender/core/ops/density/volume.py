"""Fields that say the logarithm of their density, and know no distance (NeRF, Mildenhall et al., 2020, eq. 3; Mueller
et al., 2022)."""

from __future__ import annotations

import torch
from torch import Tensor

from ..constants import MAX_LOG_DENSITY


def volume_intervals(log_density: Tensor, length_m: Tensor) -> tuple[Tensor, Tensor]:
    """Optical depths tau (N, K) of densities, logarithms (N, K) of 1 / metres, over lengths (N, K) in metres, and
    stop fractions (N, K) with all of an interval's weight at its far sample; interval 0 stands at sample 0 and its
    stop fraction is 0."""
    tau = volume_density(log_density) * length_m
    alpha = -torch.expm1(-tau)
    return tau, torch.cat([torch.zeros_like(alpha[:, :1]), alpha[:, 1:]], -1)


def volume_density(log_density: Tensor) -> Tensor:
    """Densities in 1 / metres of their logarithms, bounded."""
    return torch.exp(log_density.clamp_max(MAX_LOG_DENSITY))
