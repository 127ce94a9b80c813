"""Rays as every sensor gives them."""

from __future__ import annotations

from dataclasses import dataclass

from ..geometry import FloatArray


@dataclass(frozen=True)
class Rays:
    """origins (..., 3) and unit directions (..., 3) in the world frame, time_s (...), float64."""

    origins: FloatArray
    directions: FloatArray
    time_s: FloatArray

    def flat(self) -> Rays:
        """The same rays as one list: (N, 3), (N, 3), (N,)."""
        return Rays(self.origins.reshape(-1, 3), self.directions.reshape(-1, 3), self.time_s.reshape(-1))
