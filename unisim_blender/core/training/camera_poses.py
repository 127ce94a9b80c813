"""A small correction to how each camera is mounted, learnt with the scene: calibrations are off by a pixel or so."""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor, nn

from ..drive import Camera
from ..geometry import FloatArray
from ..strands import RayBatch


class CameraPoses(nn.Module):
    """For each camera a shift in metres and a small turn in radians, along the camera's own axes."""

    def __init__(self, cameras: int) -> None:
        super().__init__()
        self.shift_m = nn.Parameter(torch.zeros(cameras, 3))
        self.turn_rad = nn.Parameter(torch.zeros(cameras, 3))

    def forward(self, rays: RayBatch, camera: Tensor, world_from_camera: Tensor, learn: bool) -> RayBatch:
        """Corrected rays (B * n); camera (B,) and world_from_camera (B, 3, 3) of each patch. ``learn`` lets gradients through."""
        rotation = world_from_camera.to(self.shift_m)
        shift = torch.einsum("bij,bj->bi", rotation, self.shift_m[camera])
        turn = torch.einsum("bij,bj->bi", rotation, self.turn_rad[camera])
        if not learn:
            shift, turn = shift.detach(), turn.detach()
        n = len(rays) // len(camera)
        turn = turn.repeat_interleave(n, 0)
        directions = rays.directions + torch.linalg.cross(turn, rays.directions)
        directions = directions / directions.norm(dim=-1, keepdim=True)
        return RayBatch(rays.origins + shift.repeat_interleave(n, 0), directions, rays.time_s)

    def corrected(self, camera: Camera, number: int) -> Camera:
        """The camera as it is mounted after the correction: the same poses, moved in their own axes."""
        delta = np.eye(4)
        delta[:3, :3] = _rotation(self.turn_rad[number].detach().cpu().double().numpy())
        delta[:3, 3] = self.shift_m[number].detach().cpu().double().numpy()
        return dataclasses.replace(camera, world_from_camera=camera.world_from_camera.transformed(right=delta))


def _rotation(turn_rad: FloatArray) -> FloatArray:
    """The rotation (3, 3) about ``turn_rad`` (3,) by its length (Rodrigues)."""
    angle = float(np.linalg.norm(turn_rad))
    if angle == 0:
        return np.eye(3)
    x, y, z = turn_rad / angle
    k = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.asarray(np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k)
