"""Which rays pass through which spheres, in plain torch."""

from __future__ import annotations

import torch
from torch import Tensor


@torch.no_grad()
def near_spheres(origins: Tensor, directions: Tensor, bins: Tensor, centres: Tensor, radii: Tensor) -> Tensor:
    """Which rays (N, 3), directions of length 1, pass through which spheres: (N, A) bool.

    centres (T, A, 3) and radii (T, A), negative for none, are the spheres in each bin of time; a ray's bin (N,) is -1
    for none.
    """
    at = bins.clamp_min(0)
    c, r = centres[at] - origins[:, None], radii[at]
    along = (c * directions[:, None]).sum(-1)
    return ((c * c).sum(-1) - along.clamp_min(0) ** 2 <= r * r) & (r > 0) & (bins >= 0)[:, None]
