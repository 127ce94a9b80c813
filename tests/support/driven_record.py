"""Records of rollouts by hand.

The ego is 4.5 m long and 2 m wide. Its bumpers are 3.25 m ahead of its rear axle and 1.25 m behind it.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from unisim_blender.core.geometry import FloatArray, Trajectory, quaternion_from_yaw
from unisim_blender.core.simulation.scores.record import Record
from unisim_blender.core.simulation.states import EgoState, Footprint
from unisim_blender.core.world.drive import EGO

LENGTH, WIDTH, AHEAD = 4.5, 2.0, 1.0
FRONT, REAR = AHEAD + LENGTH / 2, AHEAD - LENGTH / 2

Motion = FloatArray
"""x, y, heading, speed (T, 4); NaN rows where an actor is absent."""


def times(duration_s: float, step_s: float = 0.1) -> FloatArray:
    """Times from 0 to ``duration_s``, both included."""
    return np.arange(round(duration_s / step_s) + 1) * step_s


def straight(times_s: FloatArray, x: float, y: float, heading: float, speed: float) -> Motion:
    """Motion at constant velocity."""
    out = np.empty((len(times_s), 4))
    out[:, 0] = x + np.cos(heading) * speed * times_s
    out[:, 1] = y + np.sin(heading) * speed * times_s
    out[:, 2:] = heading, speed
    return out


def trajectory(times_s: FloatArray, motion: Motion) -> Trajectory:
    """Motion as a trajectory in the plane."""
    positions = np.concatenate([motion[:, :2], np.zeros((len(motion), 1))], 1)
    return Trajectory(times_s, positions, quaternion_from_yaw(motion[:, 2]))


def footprint(uid: str, label: str, row: FloatArray, size: tuple[float, float]) -> Footprint:
    """A box whose centre is at x, y with a heading and a speed."""
    x, y, heading, speed = (float(value) for value in row)
    return Footprint(uid, label, x, y, heading, *size, speed)


def record_of(
    times_s: FloatArray,
    ego: Motion,
    actors: Mapping[str, tuple[Motion, tuple[float, float]]] | None = None,
    log: Motion | None = None,
    label: str = "Car",
    **others: Any,
) -> Record:
    """A record of the ego's motion, by its rear axle, and of actors' motions with their length and width. The log is
    the ego's own motion where none is given."""
    times_us = np.round(times_s * 1e6).astype(np.int64)
    states = tuple(EgoState(*(float(value) for value in row)) for row in ego)
    centres = ego.copy()
    centres[:, 0] += AHEAD * np.cos(ego[:, 2])
    centres[:, 1] += AHEAD * np.sin(ego[:, 2])
    boxes = tuple(footprint(EGO, "ego", row, (LENGTH, WIDTH)) for row in centres)
    present = tuple(
        tuple(
            footprint(uid, label, motion[step], size)
            for uid, (motion, size) in (actors or {}).items()
            if not np.isnan(motion[step]).all()
        )
        for step in range(len(times_s))
    )
    recorded = others.pop("recorded_ego", None) or trajectory(times_s, ego if log is None else log)
    return Record(times_us, states, boxes, present, recorded, **others)
