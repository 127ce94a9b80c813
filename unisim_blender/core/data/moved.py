"""A log in another world or time, or on another trajectory of the ego: sensors, sweeps and boxes move along."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from ..geometry import FloatArray, Trajectory, invert_pose
from ..world.drive import Actor, Camera, Drive, Lidar
from .log import Log, Sweep, SweepGrid

Choice = Literal["auto", "log", "refined"]
"""Trajectory of the ego that a log is used with: its own, one that its sweeps correct, or this where its own drifts."""
WorldMotion = Callable[[FloatArray], FloatArray]
"""Function from times (...), seconds, to poses (..., 4, 4) that take the log's world to the other one."""


class MovedLog:
    """A log that ``motion`` takes to another world, with ``later_s`` added to its times. Other members are the log's
    own."""

    def __init__(self, log: Log, drive: Drive, motion: WorldMotion, later_s: float, poses: str) -> None:
        self._log, self._motion, self._later_s = log, motion, later_s
        self.path, self.missing, self.drive, self.poses = log.path, log.missing, drive, poses

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # a copy is asked for these before it has any member
            raise AttributeError(name)
        return getattr(self._log, name)

    def _moved(self, time_s: FloatArray, points: FloatArray, directions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return points and directions (..., 3) of times (...) in the other world."""
        poses = self._motion(time_s)
        turned = np.einsum("...ij,...kj->...ki", poses[..., :3, :3], np.stack([points, directions], -2))
        return turned[..., 0, :] + poses[..., :3, 3], turned[..., 1, :]

    def sweep(self, lidar: str, frame: int) -> Sweep:
        """The recorded returns in the other world, each moved as the sensor is at its time."""
        sweep = self._log.sweep(lidar, frame)
        drops = sweep.drops
        if drops is not None:
            origins, directions = self._moved(drops.time_s, drops.origins, drops.directions)
            drops = replace(drops, origins=origins, directions=directions, time_s=drops.time_s + self._later_s)
        points, rays = self._moved(sweep.time_s, sweep.points, sweep.points - sweep.origins)
        return replace(sweep, points=points, origins=points - rays, time_s=sweep.time_s + self._later_s, drops=drops)

    def sweep_grid(self, lidar: str, frame: int) -> SweepGrid:
        """The sweep as beams x columns in the other world."""
        grid = self._log.sweep_grid(lidar, frame)
        origins, directions = self._moved(grid.time_s, grid.origins, grid.directions)
        return replace(grid, origins=origins, directions=directions, time_s=grid.time_s + self._later_s)


def moved_log(
    log: Log, motion: WorldMotion, later_s: float = 0.0, world_origin: FloatArray | None = None,
    keys_s: FloatArray | None = None, poses: str = "log",
) -> Log:  # fmt: skip
    """Return a log that ``motion`` takes to another world. ``keys_s``: times at which trajectories that ride on the ego
    get keys beside their own; ``poses``: see `LogExtras`."""
    drive = log.drive
    ego = drive.world_from_ego

    def track(own: Trajectory, keys_s: FloatArray | None = None) -> Trajectory:
        if len(own.times_s) == 1:  # what stands moves as the ego does when it is nearest
            return still(own)
        times, keyed = own.times_s, own.poses
        if keys_s is not None:
            times = np.union1d(times, keys_s)
            keyed = own.at(times)
        moved = Trajectory.from_poses(times, motion(times) @ keyed)
        return Trajectory(times + later_s, moved.positions, moved.quaternions_wxyz)

    def still(own: Trajectory) -> Trajectory:
        away = np.linalg.norm(ego.positions - own.positions.mean(0), axis=1)
        moved = own.transformed(left=motion(ego.times_s[away.argmin()]))
        return Trajectory(own.times_s + later_s, moved.positions, moved.quaternions_wxyz)

    def times(own: dict[int, float]) -> dict[int, float]:
        return {frame: time + later_s for frame, time in own.items()}

    def sensor(own: Camera | Lidar) -> Camera | Lidar:
        name = "readouts" if isinstance(own, Camera) else "phase"
        stamped = getattr(own, name)
        stamped = stamped and replace(stamped, times_s=stamped.times_s + later_s)
        along = still(own.trajectory) if own.sees_ego_body else track(own.trajectory, keys_s)
        return replace(own.along(along), time_s=times(own.time_s), **{name: stamped})

    def actor(own: Actor) -> Actor:
        path = track(own.world_from_actor) if own.is_moving else still(own.world_from_actor)
        return replace(own, world_from_actor=path, start_s=own.start_s + later_s, end_s=own.end_s + later_s)

    moved: Any = MovedLog(
        log,
        replace(
            drive.with_sensors(sensor),
            time_s=times(drive.time_s),
            world_from_ego=track(ego, keys_s),
            actors={uid: actor(own) for uid, own in drive.actors.items()},
            world_origin=drive.world_origin if world_origin is None else world_origin,
        ),
        motion,
        later_s,
        poses,
    )
    other: Log = moved
    return other


def on_trajectory(log: Log, world_from_ego: Trajectory, poses: str) -> Log:
    """Return a log whose ego goes along another trajectory; before and after it, the log's own goes on displaced as at
    its ends."""
    first, last = float(world_from_ego.times_s[0]), float(world_from_ego.times_s[-1])
    own = log.drive.world_from_ego

    def motion(time_s: FloatArray) -> FloatArray:
        within = np.clip(time_s, first, last)
        return np.asarray(world_from_ego.at(within) @ invert_pose(own.at(within)))

    return moved_log(log, motion, keys_s=world_from_ego.times_s, poses=poses)
