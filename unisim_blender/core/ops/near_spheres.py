"""Intersection of rays with spheres that bound actors over time, to select the boxes that each ray is tested
against."""

from __future__ import annotations

import torch
from torch import Tensor

from .. import native
from .devices import kernel_threads
from .dispatch import Operation


def near_spheres(origins: Tensor, directions: Tensor, bins: Tensor, centres: Tensor, radii: Tensor) -> Tensor:
    """Return which rays, origins and unit directions (N, 3), pass through which spheres: (N, A) bool.

    centres (T, A, 3) and radii (T, A), negative for none, are the spheres in each bin of time; a ray's bin (N,) is -1
    for none.
    """
    assert origins.shape == directions.shape == (len(bins), 3), (origins.shape, directions.shape, bins.shape)
    assert centres.shape == (*radii.shape, 3), (centres.shape, radii.shape)
    return OPERATION(origins, directions, bins, centres, radii)


@torch.no_grad()
def near_spheres_reference(origins: Tensor, directions: Tensor, bins: Tensor, centres: Tensor, radii: Tensor) -> Tensor:
    """`near_spheres` in plain torch."""
    at = bins.clamp_min(0)
    c, r = centres[at] - origins[:, None], radii[at]
    along = (c * directions[:, None]).sum(-1)
    return ((c * c).sum(-1) - along.clamp_min(0) ** 2 <= r * r) & (r > 0) & (bins >= 0)[:, None]


@torch.no_grad()
def near_spheres_compiled(origins: Tensor, directions: Tensor, bins: Tensor, centres: Tensor, radii: Tensor) -> Tensor:
    """`near_spheres` by the compiled kernel."""
    lib = native.library()
    assert lib is not None
    arrays = [x.contiguous() for x in (origins, directions, bins, centres, radii)]
    o, d, b, c, r = (x.data_ptr() for x in arrays)
    near = torch.empty(len(origins), radii.shape[1], dtype=torch.bool)
    lib.unisim_near_spheres(o, d, b, len(origins), c, r, radii.shape[1], near.data_ptr(), kernel_threads())
    return near


OPERATION = Operation(
    near_spheres_reference,
    lambda origins, directions, bins, centres, radii: (origins, directions, centres),
    compiled=near_spheres_compiled,
)
