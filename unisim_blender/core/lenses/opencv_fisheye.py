"""OpenCV's fisheye, the model of Kannala and Brandt: the radius is an odd polynomial of the angle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..geometry import FloatArray
from .lens import LensError
from .radial import RadialLens


@dataclass(frozen=True)
class OpenCVFisheye(RadialLens):
    """``radius = a (1 + k1 a2 + k2 a4 + k3 a6 + k4 a8)`` of the angle a. Valid while that rises, up to ``max_angle_deg``, which a
    lens's calibration often states; it may lie above 90."""

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
        """See `RadialLens.widest_rad`."""
        # straight behind the camera all headings meet
        return min(math.radians(self.max_angle_deg), math.pi * (1 - 1e-6))

    def radius(self, angle: FloatArray) -> FloatArray:
        """See `RadialLens.radius`."""
        a2 = angle * angle
        return angle * (1 + a2 * (self.k1 + a2 * (self.k2 + a2 * (self.k3 + a2 * self.k4))))

    def radius_slope(self, angle: FloatArray) -> FloatArray:
        """See `RadialLens.radius_slope`."""
        a2 = angle * angle
        return np.asarray(1 + a2 * (3 * self.k1 + a2 * (5 * self.k2 + a2 * (7 * self.k3 + a2 * 9 * self.k4))))
