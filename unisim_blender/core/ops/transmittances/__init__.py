"""How much of a ray reaches each of its intervals, through the ray segments of all fields in one order of depth."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from ..dispatch import Operation, on_cpu
from ..ray_segments import RaySegments
from . import reference


def _deciding(rays: int, ray_segments: Sequence[RaySegments]) -> Sequence[Tensor]:
    # kernels have no gradient of places
    if any(s.t.requires_grad for s in ray_segments):
        return ()
    return [x for s in ray_segments for x in (s.t, s.tau, s.stop_fraction, s.features)]


OPERATION = Operation(reference.transmittances, _deciding, {"compiled": on_cpu})


def transmittances(rays: int, ray_segments: Sequence[RaySegments]) -> list[Tensor]:
    """The transmittance before every interval (P, K) of each group of ray segments, all fields of a ray in one order
    of depth."""
    return OPERATION(rays, ray_segments)
