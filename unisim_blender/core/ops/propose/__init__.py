"""Where along a ray samples are placed: at quantiles of a distribution that the occupied voxels along it give."""

from __future__ import annotations

from torch import Tensor

from ..dispatch import Operation, on_cpu, on_gpu
from . import reference
from .voxels import RaySpans, Voxels

OPERATION = Operation(reference.propose, lambda voxels, spans, u: (u,), {"gpu": on_gpu, "compiled": on_cpu})


def propose(voxels: Voxels, spans: RaySpans, u: Tensor) -> tuple[Tensor, Tensor]:
    """Places t (N, K) at quantiles u (N, K), rising along each row, of the occupied voxels' distribution; its mass
    (N,).

    A ray is cut into steps of half a voxel; a step's mass is its voxel's value p times exp(-DECAY_PER_M * metres of p
    before). A mass of 0 says that the ray hits nothing.
    """
    return OPERATION(voxels, spans, u)
