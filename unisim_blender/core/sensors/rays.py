"""Rays as every sensor gives them, and the window of time that a frame's rays lie in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from ..world.drive import Camera, Lidar

MAX_DISTANCE_M = 1e9
"""Largest distance of anything from the origin, metres."""


def _aims(directions: FloatArray) -> BoolArray:
    """Return which directions (N, 3) are finite and of a length near 1: (N,) bool."""
    x, y, z = directions.T
    return np.abs(x * x + y * y + z * z - 1) < 0.5


def sound_directions(directions: FloatArray) -> FloatArray:
    """Return directions (N, 3), straight up where they are not finite or far from unit length."""
    aims = _aims(directions)
    return directions if aims.all() else np.where(aims[:, None], directions, (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Rays:
    """Rays: origins (..., 3), metres, and unit directions (..., 3) in the world frame, time_s (...), seconds;
    float64."""

    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray

    def flat(self) -> Rays:
        """Return the rays in one row: (N, 3), (N, 3), (N,)."""
        return Rays(self.origins.reshape(-1, 3), self.directions.reshape(-1, 3), self.time_s.reshape(-1))

    def part(self, some: NDArray[np.int64] | BoolArray | slice) -> Rays:
        """Return some of the rays, flat: by their numbers if they are flat, or by which of them."""
        return Rays(self.origins[some], self.directions[some], self.time_s[some])

    def sound(self) -> Rays:
        """Return flat rays (N,) with those that are not finite, or have no unit direction, replaced by rays that start
        far above and go up: they hit only the sky."""
        aims, timed = _aims(self.directions), np.isfinite(self.time_s)
        # a number that is not finite makes the comparison fail
        if np.abs(self.origins).max(initial=0.0) < MAX_DISTANCE_M and aims.all() and timed.all():
            return self
        some = (np.abs(self.origins) < MAX_DISTANCE_M).all(1) & aims & timed
        return Rays(
            np.where(some[:, None], self.origins, (0.0, 0.0, MAX_DISTANCE_M)),
            np.where(some[:, None], self.directions, (0.0, 0.0, 1.0)),
            np.where(some, self.time_s, 0.0),
        )


PAD_LINES = 4
"""Number of rows or columns by which cells of several pixels may extend beyond an image's edge."""


def exposure_window(sensor: Camera | Lidar, time_s: float) -> tuple[float, float]:
    """Return the first and the last time, seconds, at which rays of a sensor's frame at ``time_s`` leave; ``time_s``
    lies between them."""
    if isinstance(sensor, Lidar):
        model = sensor.model
        first, last = time_s + model.time_offset_s - model.sweep_s, time_s + model.time_offset_s
        if model.column_time_s is not None:
            first, last = (time_s + model.time_offset_s + float(end(model.column_time_s)) for end in (np.min, np.max))
        if model.beam_time_s is not None:
            early, late = float(model.beam_time_s.min()), float(model.beam_time_s.max())
            first, last = min(first, last) + early, max(first, last) + late
    else:
        shutter = sensor.model_at(time_s).shutter
        pad = PAD_LINES / (sensor.model.width if shutter.axis == "columns" else sensor.model.height)
        first, last = (time_s + shutter.duration_s * (at - shutter.reference) for at in (-pad, 1 + pad))
    return min(time_s, first, last), max(time_s, first, last)
