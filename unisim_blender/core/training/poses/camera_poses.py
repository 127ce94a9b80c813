"""A small correction of each camera's pose, learned with the scene.

Calibrations are off by a pixel or so, and recorded poses waver by as much from frame to frame, as the vehicle pitches.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from ...geometry import FloatArray, Trajectory, matrix_from_quaternion, quaternion_from_matrix
from ...ops.ray_segments import RayBatch
from ...world.drive import Camera

SMOOTH_S = 0.1
"""Corrections change as slowly as this: what two frames teach holds for the one between."""


class CameraPoses(nn.Module):
    """For each camera, at the times of the images it learns from, a shift in metres and a small turn in
    radians, along its axes.

    ``times_s``: each camera's times (K,), increasing.
    """

    def __init__(self, times_s: Sequence[FloatArray]) -> None:
        super().__init__()
        keys = max(len(t) for t in times_s)
        padded = np.full((len(times_s), keys), np.inf)
        for row, times in zip(padded, times_s, strict=True):
            row[: len(times)] = times
        self.register_buffer("times_s", torch.as_tensor(padded), persistent=False)
        self.shift_m = nn.Parameter(torch.zeros(len(times_s), keys, 3))
        self.turn_rad = nn.Parameter(torch.zeros(len(times_s), keys, 3))

    times_s: Tensor

    def at(self, camera: Tensor, time_s: Tensor) -> tuple[Tensor, Tensor]:
        """Shifts and turns (B, 3) of cameras (B,) at times (B,): means of the keys' by a Gaussian of SMOOTH_S."""
        away = ((self.times_s[camera] - time_s[:, None]) / SMOOTH_S) ** 2 / 2
        share = torch.softmax(-away, -1).to(self.shift_m)[:, None]
        return (share @ self.shift_m[camera])[:, 0], (share @ self.turn_rad[camera])[:, 0]

    def forward(self, rays: RayBatch, camera: Tensor, world_from_camera: Tensor, learn: bool) -> RayBatch:
        """Corrected rays (B * n); camera (B,) and world_from_camera (B, 3, 3) of each patch. ``learn`` lets
        gradients through."""
        n = len(rays) // len(camera)
        rotation = world_from_camera.to(self.shift_m)
        with torch.set_grad_enabled(learn and torch.is_grad_enabled()):
            shift, turn = self.at(camera, rays.time_s[::n])
            shift = torch.einsum("bij,bj->bi", rotation, shift)
            turn = torch.einsum("bij,bj->bi", rotation, turn).repeat_interleave(n, 0)
        directions = rays.directions + torch.linalg.cross(turn, rays.directions)
        directions = directions / directions.norm(dim=-1, keepdim=True)
        return RayBatch(rays.origins + shift.repeat_interleave(n, 0), directions, rays.time_s)

    def corrected(self, camera: Camera, number: int) -> Camera:
        """The camera with its corrected trajectory: every pose is moved in its own axes."""
        from scipy.spatial.transform import Rotation  # a tenth of what a training imports, and needed at its end

        trajectory = camera.world_from_camera
        with torch.no_grad():
            times = torch.as_tensor(trajectory.times_s, device=self.times_s.device)
            at = self.at(torch.full_like(times, number, dtype=torch.long), times)
        shift, turn = (value.cpu().double().numpy() for value in at)
        rotation = matrix_from_quaternion(trajectory.quaternions_wxyz)
        positions = trajectory.positions + np.einsum("kij,kj->ki", rotation, shift)
        quaternions = quaternion_from_matrix(rotation @ Rotation.from_rotvec(turn).as_matrix())
        return dataclasses.replace(camera, world_from_camera=Trajectory(trajectory.times_s, positions, quaternions))
