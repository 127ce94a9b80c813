"""The box of space that the static field fills."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import SceneError
from ..geometry import FloatArray, invert_pose, make_pose, quaternion_from_yaw, transform_points
from ..world.drive import Drive

MAX_EDGE_M = 1e4
"""Largest edge of a volume, metres."""
WINDING_RAD, WINDING_M = np.pi / 4, 150.0
"""Turn, radians, and length, metres, above which a drive winds; a shorter one lies nearly within a straight one's
box."""


@dataclass(frozen=True)
class Volume:
    """An upright box along the drive: ``world_from_volume`` (4, 4) puts its lower corner at the origin; size_m (3,)."""

    world_from_volume: FloatArray
    size_m: FloatArray

    @property
    def corner(self) -> FloatArray:
        """The lower corner (3,), world frame, from which float32 coordinates are measured, wherever the drive is."""
        return self.world_from_volume[:3, 3]

    @staticmethod
    def along(
        drive: Drive, behind_m: float = 80, ahead_m: float = 80, width_m: float = 120, height_m: float = 40
    ) -> Volume:
        """80 m behind the first ego pose, 80 m ahead of the last, 120 m wide, 40 m high
        (UniSim's supplement, section 1).

        It reaches 8 m below the lowest ego position, for streets that fall away. A drive that turns widens it. One that winds has
        the smallest box in which each of its places has as much room as a straight drive's.
        """
        times = np.array([drive.time_s[f] for f in drive.frames])
        poses = drive.world_from_ego.at(times)
        if winds(poses):
            return _round(poses, behind_m, ahead_m, width_m, height_m)
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
        """Return the volume of `to_dict`. Raises `SceneError`, which names the value at fault."""
        read = {}
        for name, shape in (("world_from_volume", (4, 4)), ("size_m", (3,))):
            try:
                read[name] = np.array(values[name], np.float64)
            except (KeyError, TypeError, ValueError) as error:
                raise SceneError(f"scene.json: the volume's {name} is missing or no array of numbers") from error
            if read[name].shape != shape or not np.isfinite(read[name]).all():
                raise SceneError(f"scene.json: the volume's {name} is not {shape} finite numbers")
        volume = Volume(read["world_from_volume"], read["size_m"])
        volume.check("scene.json: the volume's size_m")
        return volume

    def check(self, where: str) -> None:
        """Check that the edges can be those of a scene. SceneError names ``where``."""
        if not ((self.size_m > 0) & (self.size_m < MAX_EDGE_M)).all():
            raise SceneError(f"{where} is {self.size_m.tolist()}, not above 0 and below {MAX_EDGE_M:.0f} m")


def driven_m(poses: FloatArray) -> float:
    """Return the distance, metres, that a vehicle drove, by its poses (T, 4, 4)."""
    return float(np.linalg.norm(np.diff(poses[:, :2, 3], axis=0), axis=1).sum())


def winds(poses: FloatArray) -> bool:
    """Return whether a drive by these poses (T, 4, 4) winds, so that the box of a straight one would leave it little room."""
    heading = np.unwrap(np.arctan2(poses[:, 1, 0], poses[:, 0, 0]))
    return bool(np.ptp(heading) > WINDING_RAD and driven_m(poses) > WINDING_M)


def _round(poses: FloatArray, behind_m: float, ahead_m: float, width_m: float, height_m: float) -> Volume:
    """Return the upright box of least area round all places of a drive, ``width_m`` / 2 to their sides, and what is
    behind and ahead."""
    sides = np.array([-width_m / 2, width_m / 2])
    along = np.concatenate([poses[:1] @ _shift(-behind_m), poses, poses[-1:] @ _shift(ahead_m)])
    corners = np.concatenate([along @ _shift(0.0, side) for side in sides])[:, :3, 3]
    best = None
    for yaw in np.radians(np.arange(0.0, 90.0, 1.0)):
        turned = make_pose(np.zeros(3), quaternion_from_yaw(yaw))
        local = transform_points(invert_pose(turned), corners)
        low, high = local.min(0), local.max(0)
        area = float(np.prod((high - low)[:2]))
        if best is None or area < best[0] * (1 - 1e-9):
            best = area, turned, low, high
    assert best is not None
    _, turned, low, high = best
    heights = poses[:, 2, 3]
    low[2] = heights.min() - 8.0
    high[2] = low[2] + max(height_m, float(np.ptp(heights)) + 32.0)
    turned[:3, 3] = transform_points(turned, low[None])[0]
    return Volume(turned, high - low)


def _shift(ahead_m: float, left_m: float = 0.0) -> FloatArray:
    pose = np.eye(4)
    pose[:2, 3] = ahead_m, left_m
    return pose
