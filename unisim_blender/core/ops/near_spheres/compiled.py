"""Which rays pass through which spheres, by the compiled kernels."""

from __future__ import annotations

import torch
from torch import Tensor

from ... import native
from ..devices import kernel_threads


@torch.no_grad()
def near_spheres(origins: Tensor, directions: Tensor, bins: Tensor, centres: Tensor, radii: Tensor) -> Tensor:
    """See `near_spheres.near_spheres`."""
    lib = native.library()
    assert lib is not None
    arrays = [x.contiguous() for x in (origins, directions, bins, centres, radii)]
    o, d, b, c, r = (x.data_ptr() for x in arrays)
    near = torch.empty(len(origins), radii.shape[1], dtype=torch.bool)
    lib.unisim_near_spheres(o, d, b, len(origins), c, r, radii.shape[1], near.data_ptr(), kernel_threads())
    return near
