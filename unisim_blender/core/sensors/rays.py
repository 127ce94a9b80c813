"""Rays as every sensor gives them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import BoolArray, FloatArray

NOWHERE_M = 1e9
"""Farther from the origin than this nothing is."""


def _aims(directions: FloatArray) -> BoolArray:
    """Which of the directions (N, 3) are some: finite, and of a length near 1."""
    x, y, z = directions.T
    return np.abs(x * x + y * y + z * z - 1) < 0.5


def sound_directions(directions: FloatArray) -> FloatArray:
    """Directions (N, 3), straight up where they are none."""
    aims = _aims(directions)
    return directions if aims.all() else np.where(aims[:, None], directions, (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Rays:
    """origins (..., 3) and unit directions (..., 3) in the world frame, time_s (...), float64."""

    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray

    def flat(self) -> Rays:
        """The same rays as one list: (N, 3), (N, 3), (N,)."""
        return Rays(self.origins.reshape(-1, 3), self.directions.reshape(-1, 3), self.time_s.reshape(-1))

    def sound(self) -> Rays:
        """The same flat rays; those with a number that is not finite, or without a direction, start far above and go up
        instead: they hit nothing but the sky."""
        aims, timed = _aims(self.directions), np.isfinite(self.time_s)
        # a number that is not finite makes the comparison fail
        if np.abs(self.origins).max(initial=0.0) < NOWHERE_M and aims.all() and timed.all():
            return self
        some = (np.abs(self.origins) < NOWHERE_M).all(1) & aims & timed
        return Rays(
            np.where(some[:, None], self.origins, (0.0, 0.0, NOWHERE_M)),
            np.where(some[:, None], self.directions, (0.0, 0.0, 1.0)),
            np.where(some, self.time_s, 0.0),
        )
