"""From optical depths to transmittances."""

from __future__ import annotations

import torch
from torch import Tensor


def weights_from_tau(tau: Tensor) -> tuple[Tensor, Tensor]:
    """Transmittances in front of each interval (N, K) and behind the last (N,), of optical depths in depth order (N,
    K)."""
    total = torch.cumsum(tau, -1)
    # shifted, for total - tau would lose what a thin interval before a dense one has taken away
    before = torch.cat([torch.zeros_like(total[:, :1]), total[:, :-1]], -1)
    return torch.exp(-before), torch.exp(-total[:, -1])
