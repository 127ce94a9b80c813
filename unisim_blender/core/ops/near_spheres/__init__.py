"""Which rays pass through which spheres, that bound actors over time: the actors whose boxes rays are tried
against."""

from __future__ import annotations

from torch import Tensor

from ..dispatch import Operation, on_cpu
from . import reference

OPERATION = Operation(
    reference.near_spheres,
    lambda origins, directions, bins, centres, radii: (origins, directions, centres),
    {"compiled": on_cpu},
)


def near_spheres(origins: Tensor, directions: Tensor, bins: Tensor, centres: Tensor, radii: Tensor) -> Tensor:
    """Which rays (N, 3), directions of length 1, pass through which spheres: (N, A) bool.

    centres (T, A, 3) and radii (T, A), negative for none, are the spheres in each bin of time; a ray's bin (N,) is -1
    for none.
    """
    return OPERATION(origins, directions, bins, centres, radii)
