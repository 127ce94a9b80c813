"""A volume as tensors, and the contraction of everything outside it."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...geometry import FloatArray
from .volume import Volume


class VolumeFrame(torch.nn.Module):
    """A volume as tensors: points and directions into its own axes, and where rays enter and leave it.

    Tensors hold world points along the world's axes, less the volume's `corner`, as `recentred` makes them.
    """

    def __init__(self, volume: Volume) -> None:
        super().__init__()
        self.corner = volume.corner
        rotation = np.ascontiguousarray(volume.world_from_volume[:3, :3].T)
        self.register_buffer("rotation", torch.as_tensor(rotation).float(), persistent=False)
        self.register_buffer("size_m", torch.as_tensor(volume.size_m).float(), persistent=False)

    rotation: Tensor
    size_m: Tensor

    def recentred(self, points: FloatArray) -> Tensor:
        """World points (..., 3) from the corner, subtracted in float64: float32 knows a place to 1e-7
        of its distance."""
        return torch.as_tensor(points - self.corner).to(self.rotation.dtype).to(self.rotation.device)

    def points(self, x: Tensor) -> Tensor:
        """Recentred points (..., 3) along the volume's axes."""
        return x @ self.rotation.T

    def vectors(self, d: Tensor) -> Tensor:
        """World directions (..., 3) along the volume's axes."""
        return d @ self.rotation.T

    def inside(self, x: Tensor) -> Tensor:
        """Which points (..., 3) in volume coordinates lie in the volume: (...) bool."""
        return ((x > 0) & (x < self.size_m)).all(-1)

    def span(self, o: Tensor, d: Tensor, near_m: float) -> tuple[Tensor, Tensor]:
        """Where rays in volume coordinates (N, 3) are inside it: t_near, t_far (N,); t_far <= t_near
        where they miss."""
        safe = torch.where(d.abs() < 1e-9, torch.full_like(d, 1e-9), d)
        a, b = -o / safe, (self.size_m - o) / safe
        t_near = torch.minimum(a, b).amax(-1).clamp_min(near_m)
        t_far = torch.maximum(a, b).amin(-1)
        return t_near, torch.maximum(t_far, t_near)


def contract(x: Tensor, radius_m: float) -> Tensor:
    """Points (N, 3) about the origin into the unit cube: space within ``radius_m`` to its inner half, the
    rest to the shell.

    mip-NeRF 360's contraction (Barron et al., 2022, eq. 10), moved from the ball of radius 2 into [0, 1].
    """
    x = x / radius_m
    norm = x.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    return torch.where(norm <= 1, x, (2 - 1 / norm) * x / norm) / 4 + 0.5


def contract_direction(d: Tensor) -> Tensor:
    """Where a ray ends at infinity: directions (N, 3) on the shell of `contract`."""
    return d / 2 + 0.5
