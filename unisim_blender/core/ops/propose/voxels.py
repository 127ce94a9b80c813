"""Occupied voxels, and rays through them."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True)
class Voxels:
    """A grid of values 0..255 (X, Y, Z) uint8 from ``lower`` (3,) on, in cells of ``voxel_m``; 0 is free space."""

    values: Tensor
    lower: Tensor
    voxel_m: float


@dataclass(frozen=True)
class RaySpans:
    """Rays through the voxels, and the part of each in which samples are placed: origins, directions (N, 3) in the
    voxels' frame, from t_near to t_far (N,)."""

    origins: Tensor
    directions: Tensor
    t_near: Tensor
    t_far: Tensor
