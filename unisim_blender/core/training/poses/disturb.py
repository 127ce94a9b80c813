"""Noise on the boxes of a drive, to see how much of it training takes back."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np

from ...data.log import Log
from ...geometry import Trajectory, quaternion_from_yaw
from ...scenario.motion.trajectories import quaternion_product
from ...world.drive import Actor, Drive


def disturbed(drive: Drive, metres: float, degrees: float, seed: int) -> Drive:
    """The drive with Gaussian noise on the boxes of its moving actors, each key's its own: a shift along the world's x
    and y and a turn about its z, with standard deviations of so many metres along each axis, and degrees."""
    rng = np.random.default_rng([seed, 0xB0])
    actors = {uid: _disturbed(drive.actors[uid], metres, degrees, rng) for uid in sorted(drive.actors)}
    return replace(drive, actors={uid: actors[uid] for uid in drive.actors})


def _disturbed(actor: Actor, metres: float, degrees: float, rng: np.random.Generator) -> Actor:
    if not actor.is_moving:
        return actor
    trajectory = actor.world_from_actor
    shift = np.pad(rng.normal(0, metres, (len(trajectory.times_s), 2)), ((0, 0), (0, 1)))
    turn = quaternion_from_yaw(rng.normal(0, np.radians(degrees), len(trajectory.times_s)))
    moved = Trajectory(
        trajectory.times_s, trajectory.positions + shift, quaternion_product(turn, trajectory.quaternions_wxyz)
    )
    return replace(actor, world_from_actor=moved)


def with_drive(log: Log, drive: Drive) -> Log:
    """The log with another drive; images and sweeps are what they were."""
    changed = copy.copy(log)
    changed.drive = drive
    return changed
