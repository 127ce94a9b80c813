"""How the vehicle stands: its height, roll and pitch at a place, by the scene's ground and by the recorded drive."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...geometry import FloatArray, Trajectory, angles_from_rotation
from ..footprints import shorter_arc
from ..states import EgoState
from .parameters import Attitude, Vehicle

Heights = Callable[[FloatArray], FloatArray]
"""How high points (N, 3), world frame, are above the ground (N,), metres, as `render.tracer.Tracer.heights`."""
METRES_PER_RAD = 2.0
"""A recorded heading that differs by a radian makes a place so much less near: paths cross, and lead both ways."""
SAME_M, SAME_RAD = 1e-6, 1e-6
"""A vehicle so near to a recorded pose is on it. Grounds in float32 would tell the two apart."""
REFINEMENTS = 8
NEAR_KEYS = 64
"""Largest number of states that are compared with all keys in one batch."""


def axle_height(world_from_ego: FloatArray, vehicle: Vehicle, heights: Heights) -> float:
    """Return how high the rear axle's middle is above the ground, of a vehicle whose ego frame has this pose (4, 4); 0 where
    there is no ground."""
    axle = world_from_ego @ vehicle.ego_from_axle
    height = float(heights(axle[None, :3, 3])[0])
    return height if math.isfinite(height) else 0.0


@dataclass(frozen=True)
class VehicleGround:
    """Where a simulated vehicle finds its height, roll and pitch.

    ``recorded`` is the recorded trajectory of the log's ego frame. With ``heights``, the vehicle stands on the ground under its
    four wheels, and keeps the recorded pose's offset from the ground that was below it, at the nearest recorded place; where
    the ground is not finite, or without ``heights``, it has the recorded height, roll and pitch of that place. On a recorded
    pose it is as recorded.
    """

    recorded: Trajectory
    vehicle: Vehicle
    heights: Heights | None = None

    def attitude(self, state: EgoState) -> Attitude:
        """Return height, roll and pitch of a vehicle in this state."""
        return self.attitudes([state])[0]

    def attitudes(self, states: Sequence[EgoState]) -> list[Attitude]:
        """Return height, roll and pitch of vehicles in these states; the ground is asked for once."""
        if not states:
            return []
        places = np.array([(state.x_m, state.y_m, state.heading_rad) for state in states])
        poses = self.recorded.at(self._nearest_times(places))
        origins = poses[:, :3, :3] @ np.array(self.vehicle.rear_axle_m) + poses[:, :3, 3]
        yaw, pitch, roll = angles_from_rotation(poses[:, :3, :3])
        attitudes = np.stack([origins[:, 2], roll, pitch], -1)
        if self.heights is not None:
            recorded = np.stack([origins[:, 0], origins[:, 1], yaw], -1)
            standing = self._on_ground(np.concatenate([places, recorded]), np.tile(origins[:, 2], 2))
            here, there = standing[: len(states)], standing[len(states) :]
            off = np.hypot(*(places - recorded)[:, :2].T), shorter_arc(places[:, 2] - yaw)
            moved = ~((off[0] < SAME_M) & (np.abs(off[1]) < SAME_RAD)) & np.isfinite(here + there).all(1)
            attitudes[moved] += (here - there)[moved]
        return [Attitude(*row) for row in attitudes.tolist()]

    def _on_ground(self, places: FloatArray, z_m: FloatArray) -> FloatArray:
        """Height, roll and pitch (N, 3) of the plane under the wheels of vehicles at x, y and heading (N, 3)."""
        assert self.heights is not None
        half, base = self.vehicle.track_m / 2, self.vehicle.wheelbase_m
        wheels = np.array([(0.0, half), (0.0, -half), (base, half), (base, -half)])
        c, s = np.cos(places[:, 2:]), np.sin(places[:, 2:])
        points = np.empty((len(places), 4, 3))
        points[..., 0] = places[:, :1] + c * wheels[:, 0] - s * wheels[:, 1]
        points[..., 1] = places[:, 1:2] + s * wheels[:, 0] + c * wheels[:, 1]
        points[..., 2] = z_m[:, None]
        above = np.asarray(self.heights(points.reshape(-1, 3)), np.float64).reshape(-1, 4)
        rear_left, rear_right, front_left, front_right = (points[..., 2] - above).T
        rear, front = (rear_left + rear_right) / 2, (front_left + front_right) / 2
        left, right = (rear_left + front_left) / 2, (rear_right + front_right) / 2
        roll, pitch = np.arctan2(left - right, 2 * half), -np.arctan2(front - rear, base)
        return np.stack([rear, roll, pitch], -1)

    @cached_property
    def _keys(self) -> tuple[FloatArray, FloatArray]:
        """Places (T, 2) of the rear axle at the recorded trajectory's keys, and headings (T,)."""
        return self._axle(self.recorded.times_s)

    def _axle(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        poses = self.recorded.at(times_s)
        places = (poses[..., :3, :3] @ np.array(self.vehicle.rear_axle_m) + poses[..., :3, 3])[..., :2]
        return places, angles_from_rotation(poses[..., :3, :3])[0]

    def _nearest_times(self, places: FloatArray) -> FloatArray:
        """The times (N,) at which the recorded vehicle was nearest to x, y and heading (N, 3)."""
        times = self.recorded.times_s
        if len(times) == 1:
            return np.full(len(places), times[0])
        nearest = np.concatenate(
            [self._between_keys(some) for some in np.array_split(places, -(-len(places) // NEAR_KEYS))]
        )
        # between two keys, an axle off the origin is not quite on the straight line
        for _ in range(REFINEMENTS if any(self.vehicle.rear_axle_m) else 0):
            lower = np.clip(np.searchsorted(times, nearest, "right") - 1, 0, len(times) - 2)
            step = 1e-3 * (times[lower + 1] - times[lower])
            before, here, after = (self._axle(nearest + offset)[0] for offset in (-step, 0.0, step))
            slope = (after - before) / (2 * step)[:, None]
            square = np.maximum((slope**2).sum(-1), 1e-12)
            moved = nearest + ((places[:, :2] - here) * slope).sum(-1) / square
            nearest = np.clip(moved, times[lower], times[lower + 1])
        return nearest

    def _between_keys(self, places: FloatArray) -> FloatArray:
        keys, heading = self._keys
        start, leg = keys[:-1], np.diff(keys, axis=0)
        length = (leg**2).sum(-1)
        along = ((places[:, None, :2] - start) * leg).sum(-1) / np.where(length > 0, length, 1.0)
        u = np.clip(along, 0.0, 1.0)
        off = start + u[..., None] * leg - places[:, None, :2]
        turned = shorter_arc(heading[:-1] + u * shorter_arc(np.diff(heading)) - places[:, 2:])
        nearest = np.argmin((off**2).sum(-1) + (METRES_PER_RAD * turned) ** 2, 1)
        times, row = self.recorded.times_s, np.arange(len(places))
        return np.asarray(times[nearest] + u[row, nearest] * (times[nearest + 1] - times[nearest]))
