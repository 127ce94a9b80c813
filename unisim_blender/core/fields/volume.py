"""The box of space that the static field fills, and the contraction of everything outside it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..drive import Drive
from ..errors import SceneError
from ..geometry import FloatArray, invert_pose, make_pose, quaternion_from_yaw, transform_points

MOST_M = 1e4
"""Edges of a volume are shorter."""


@dataclass(frozen=True)
class Volume:
    """An upright box along the drive: ``world_from_volume`` (4, 4) puts its lower corner at the origin; size_m (3,)."""

    world_from_volume: FloatArray
    size_m: FloatArray

    @staticmethod
    def along(drive: Drive, behind_m: float = 80, ahead_m: float = 80, width_m: float = 120, height_m: float = 40) -> Volume:
        """80 m behind the first ego pose, 80 m ahead of the last, 120 m wide, 40 m high (UniSim's supplement, section 1).

        It reaches 8 m below the lowest ego position, for streets that fall away. A drive that turns widens it.
        """
        times = np.array([drive.time_s[f] for f in drive.frames])
        poses = drive.world_from_ego.at(times)
        way = poses[-1, :2, 3] - poses[0, :2, 3]
        heading = way if np.linalg.norm(way) > 1.0 else poses[0, :2, 0]
        yaw = float(np.arctan2(heading[1], heading[0]))
        turned = make_pose(np.zeros(3), quaternion_from_yaw(yaw))
        local = transform_points(invert_pose(turned), poses[:, :3, 3])
        low, high = local.min(0), local.max(0)
        middle = (low[1] + high[1]) / 2
        width = max(width_m, float(high[1] - low[1]) + 60.0)
        lower = np.array([low[0] - behind_m, middle - width / 2, low[2] - 8.0])
        upper = np.array([high[0] + ahead_m, middle + width / 2, lower[2] + max(height_m, float(high[2] - low[2]) + 32.0)])
        turned[:3, 3] = transform_points(turned, lower[None])[0]
        return Volume(turned, upper - lower)

    def to_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {"world_from_volume": self.world_from_volume.tolist(), "size_m": self.size_m.tolist()}

    @staticmethod
    def from_dict(values: dict[str, Any]) -> Volume:
        """The inverse of `to_dict`; SceneError names what does not fit."""
        read = {}
        for name, shape in (("world_from_volume", (4, 4)), ("size_m", (3,))):
            try:
                read[name] = np.array(values[name], np.float64)
            except (KeyError, TypeError, ValueError) as error:
                raise SceneError(f"scene.json: the volume's {name} is missing or no array of numbers") from error
            if read[name].shape != shape or not np.isfinite(read[name]).all():
                raise SceneError(f"scene.json: the volume's {name} is not {shape} finite numbers")
        size = read["size_m"]
        if not ((size > 0) & (size < MOST_M)).all():
            raise SceneError(f"scene.json: the volume's size_m is {size.tolist()}, not above 0 and below {MOST_M:.0f} m")
        return Volume(read["world_from_volume"], size)


class VolumeFrame(torch.nn.Module):
    """A volume as tensors: world points and directions into its own axes, and where rays enter and leave it."""

    def __init__(self, volume: Volume) -> None:
        super().__init__()
        pose = torch.as_tensor(invert_pose(volume.world_from_volume))
        self.register_buffer("rotation", pose[:3, :3].float(), persistent=False)
        self.register_buffer("translation", pose[:3, 3].float(), persistent=False)
        self.register_buffer("size_m", torch.as_tensor(volume.size_m).float(), persistent=False)

    rotation: Tensor
    translation: Tensor
    size_m: Tensor

    def points(self, x: Tensor) -> Tensor:
        """World points (..., 3) in metres from the volume's lower corner."""
        return x @ self.rotation.T + self.translation

    def vectors(self, d: Tensor) -> Tensor:
        """World directions (..., 3) along the volume's axes."""
        return d @ self.rotation.T

    def inside(self, x: Tensor) -> Tensor:
        """Which points (..., 3) in volume coordinates lie in the volume: (...) bool."""
        return ((x > 0) & (x < self.size_m)).all(-1)

    def span(self, o: Tensor, d: Tensor, near_m: float) -> tuple[Tensor, Tensor]:
        """Where rays in volume coordinates (N, 3) are inside it: t_near, t_far (N,); t_far <= t_near where they miss."""
        safe = torch.where(d.abs() < 1e-9, torch.full_like(d, 1e-9), d)
        a, b = -o / safe, (self.size_m - o) / safe
        t_near = torch.minimum(a, b).amax(-1).clamp_min(near_m)
        t_far = torch.maximum(a, b).amin(-1)
        return t_near, torch.maximum(t_far, t_near)


def contract(x: Tensor, radius_m: float) -> Tensor:
    """Points (N, 3) about the origin into the unit cube: space within ``radius_m`` to its inner half, the rest to the shell.

    mip-NeRF 360's contraction (Barron et al., 2022, eq. 10), moved from the ball of radius 2 into [0, 1].
    """
    x = x / radius_m
    norm = x.norm(dim=-1, keepdim=True).clamp_min(1e-9)
    return torch.where(norm <= 1, x, (2 - 1 / norm) * x / norm) / 4 + 0.5


def contract_direction(d: Tensor) -> Tensor:
    """Where a ray ends at infinity: directions (N, 3) on the shell of `contract`."""
    return d / 2 + 0.5
