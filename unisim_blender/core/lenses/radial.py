"""Lenses whose image is round about the optical axis: a radius for each angle."""

from __future__ import annotations

from abc import abstractmethod
from functools import cached_property

import numpy as np

from ..geometry import BoolArray, FloatArray
from .lens import EDGE, Lens, angle_and_heading, direction_of
from .monotonic import STEEPEST, Inverse, end_of_rise


class RadialLens(Lens):
    """A lens by its radius of an angle; valid while the radius rises, and up to `widest_rad`."""

    @property
    @abstractmethod
    def widest_rad(self) -> float:
        """The domain ends here at the latest."""

    @abstractmethod
    def radius(self, angle: FloatArray) -> FloatArray:
        """The radius in the plane (...) of angles (...) in radians."""

    @abstractmethod
    def radius_slope(self, angle: FloatArray) -> FloatArray:
        """Its derivative (...)."""

    @cached_property
    def _end(self) -> float:
        return end_of_rise(self.radius_slope, self.widest_rad, STEEPEST)

    @cached_property
    def _inverse(self) -> Inverse:
        return Inverse(self.radius, self.radius_slope, self._end)

    @property
    def max_angle_rad(self) -> float:
        """See `Lens.max_angle_rad`."""
        return self._end

    @property
    def axis_slope(self) -> float:
        """See `Lens.axis_slope`."""
        return float(self.radius_slope(np.zeros(1))[0])

    def project(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """See `Lens.project`."""
        angle, x, y = angle_and_heading(points)
        valid = np.isfinite(points).all(-1) & (angle <= self.max_angle_rad * EDGE)
        radius = self.radius(np.where(valid, angle, 0.0))
        return np.where(valid[..., None], np.stack([radius * x, radius * y], -1), np.nan), valid

    def unproject(self, plane: FloatArray) -> FloatArray:
        """See `Lens.unproject`."""
        x, y = plane[..., 0], plane[..., 1]
        radius = np.hypot(x, y)
        angle, valid = self._inverse(radius)
        return np.where(valid[..., None], direction_of(angle, x, y, radius), np.nan)
