"""How recorded actors stand at a clock's times, as an import has them."""

from __future__ import annotations

import numpy as np

from ...core.geometry import BoolArray, FloatArray
from ...core.world.drive import Actor, Drive
from .clock import Clock


def recorded_poses(actor: Actor, clock: Clock) -> FloatArray:
    """Poses (N, 4, 4) of an actor as the import has them."""
    trajectory = actor.world_from_actor
    return trajectory.at(clock.times_s if actor.is_moving else np.full(len(clock.times_s), trajectory.times_s[0]))


def recorded_there(actor: Actor, drive: Drive, clock: Clock) -> BoolArray:
    """Whether an actor is there (N,) as the import has it."""
    start, end = drive.window(actor)
    return np.asarray((clock.times_s >= start) & (clock.times_s <= end))
