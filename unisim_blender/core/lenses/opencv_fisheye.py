"""OpenCV's fisheye, the model of Kannala and Brandt: the radius is an odd polynomial of the angle.

`RadialLens` is the base class of lenses that are radially symmetric about the optical axis."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..geometry import BoolArray, FloatArray
from .lens import EDGE, Lens, LensError, angle_and_heading, direction_of
from .monotonic import STEEPEST, Inverse, end_of_rise


class RadialLens(Lens):
    """A lens whose radius is a function of the angle; valid while the radius rises, and up to `widest_rad`."""

    @property
    @abstractmethod
    def widest_rad(self) -> float:
        """Largest angle of the valid domain, radians."""

    @abstractmethod
    def radius(self, angle: FloatArray) -> FloatArray:
        """Return the radius (...) in the plane of angles (...), radians."""

    @abstractmethod
    def radius_slope(self, angle: FloatArray) -> FloatArray:
        """Return the derivative (...) of `radius` at angles (...), radians."""

    @cached_property
    def _end(self) -> float:
        return end_of_rise(self.radius_slope, self.widest_rad, STEEPEST)

    @cached_property
    def _inverse(self) -> Inverse:
        return Inverse(self.radius, self.radius_slope, self._end)

    @property
    def max_angle_rad(self) -> float:
        return self._end

    @property
    def axis_slope(self) -> float:
        return float(self.radius_slope(np.zeros(1))[0])

    def project(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        angle, x, y = angle_and_heading(points)
        valid = np.isfinite(points).all(-1) & (angle <= self.max_angle_rad * EDGE)
        radius = self.radius(np.where(valid, angle, 0.0))
        return np.where(valid[..., None], np.stack([radius * x, radius * y], -1), np.nan), valid

    def unproject(self, plane: FloatArray) -> FloatArray:
        x, y = plane[..., 0], plane[..., 1]
        radius = np.hypot(x, y)
        angle, valid = self._inverse(radius)
        return np.where(valid[..., None], direction_of(angle, x, y, radius), np.nan)


@dataclass(frozen=True)
class OpenCVFisheye(RadialLens):
    """``radius = a (1 + k1 a2 + k2 a4 + k3 a6 + k4 a8)`` of the angle a. Valid while that rises, up to
    ``max_angle_deg``, which a lens's calibration often states; it may lie above 90."""

    TYPE: ClassVar[str] = "opencv_fisheye"

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    max_angle_deg: float = 180.0

    def __post_init__(self) -> None:
        self.check_numbers("k1", "k2", "k3", "k4", "max_angle_deg")
        if not 0 < self.max_angle_deg <= 180:
            raise LensError(f"{self.TYPE}: max_angle_deg must lie above 0 and at most at 180, not {self.max_angle_deg}")
        self.check_domain()

    @property
    def widest_rad(self) -> float:
        # straight behind the camera all headings meet
        return min(math.radians(self.max_angle_deg), math.pi * (1 - 1e-6))

    def radius(self, angle: FloatArray) -> FloatArray:
        a2 = angle * angle
        return angle * (1 + a2 * (self.k1 + a2 * (self.k2 + a2 * (self.k3 + a2 * self.k4))))

    def radius_slope(self, angle: FloatArray) -> FloatArray:
        a2 = angle * angle
        return np.asarray(1 + a2 * (3 * self.k1 + a2 * (5 * self.k2 + a2 * (7 * self.k3 + a2 * 9 * self.k4))))
