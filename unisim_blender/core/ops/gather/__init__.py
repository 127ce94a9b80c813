"""What ray segments give to their rays: weights of samples, and sums by them."""

from __future__ import annotations

from collections.abc import Sequence

from torch import Tensor

from ..dispatch import Operation, on_cpu, on_gpu
from ..ray_segments import RaySegments
from . import reference


def _deciding(ray_segment: RaySegments, before: Tensor) -> Sequence[Tensor]:
    # kernels have no gradient of places
    if ray_segment.t.requires_grad:
        return ()
    return ray_segment.t, ray_segment.tau, ray_segment.stop_fraction, ray_segment.features


OPERATION = Operation(reference.gather, _deciding, {"gpu": on_gpu, "compiled": on_cpu})


def gather(ray_segment: RaySegments, before: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Weights of the intervals and of the samples (P, K) of ray segments with transmittances ``before`` (P, K), and
    what they give (P, F + 3): features by weight, the weight, distance by weight, optical depth."""
    return OPERATION(ray_segment, before)
