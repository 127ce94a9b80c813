"""The box of space that the static field fills."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...errors import SceneError
from ...geometry import FloatArray, invert_pose, make_pose, quaternion_from_yaw, transform_points
from ...world.drive import Drive

MOST_M = 1e4
"""Edges of a volume are shorter."""


@dataclass(frozen=True)
class Volume:
    """An upright box along the drive: ``world_from_volume`` (4, 4) puts its lower corner at the origin; size_m (3,)."""

    world_from_volume: FloatArray
    size_m: FloatArray

    @property
    def corner(self) -> FloatArray:
        """Where the lower corner lies (3,), world frame: what becomes float32 is measured from here,
        wherever the drive is."""
        return self.world_from_volume[:3, 3]

    @staticmethod
    def along(
        drive: Drive, behind_m: float = 80, ahead_m: float = 80, width_m: float = 120, height_m: float = 40
    ) -> Volume:
        """80 m behind the first ego pose, 80 m ahead of the last, 120 m wide, 40 m high
        (UniSim's supplement, section 1).

        It reaches 8 m below the lowest ego position, for streets that fall away. A drive that turns widens it.
        """
        times = np.array([drive.time_s[f] for f in drive.frames])
        poses = drive.world_from_ego.at(times)
        travelled = poses[-1, :2, 3] - poses[0, :2, 3]
        heading = travelled if np.linalg.norm(travelled) > 1.0 else poses[0, :2, 0]
        yaw = float(np.arctan2(heading[1], heading[0]))
        turned = make_pose(np.zeros(3), quaternion_from_yaw(yaw))
        local = transform_points(invert_pose(turned), poses[:, :3, 3])
        low, high = local.min(0), local.max(0)
        middle = (low[1] + high[1]) / 2
        width = max(width_m, float(high[1] - low[1]) + 60.0)
        lower = np.array([low[0] - behind_m, middle - width / 2, low[2] - 8.0])
        upper = np.array(
            [high[0] + ahead_m, middle + width / 2, lower[2] + max(height_m, float(high[2] - low[2]) + 32.0)]
        )
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
            raise SceneError(
                f"scene.json: the volume's size_m is {size.tolist()}, not above 0 and below {MOST_M:.0f} m"
            )
        return Volume(read["world_from_volume"], size)
