"""A lens: the stereographic projection."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import FloatArray
from unisim_blender.core.lenses.lens import LensError
from unisim_blender.core.lenses.opencv_fisheye import RadialLens


@dataclass(frozen=True)
class Stereographic(RadialLens):
    """``radius = 2 tan(angle / 2)``: small circles stay circles."""

    TYPE = "stereographic"

    max_angle_deg: float = 120.0

    def __post_init__(self) -> None:
        self.check_numbers("max_angle_deg")
        if not 0 < self.max_angle_deg <= 170:
            raise LensError(f"{self.TYPE}: max_angle_deg must lie above 0 and at most at 170, not {self.max_angle_deg}")
        self.check_domain()

    @property
    def widest_rad(self) -> float:
        return math.radians(self.max_angle_deg)

    def radius(self, angle: FloatArray) -> FloatArray:
        return 2 * np.tan(angle / 2)

    def radius_slope(self, angle: FloatArray) -> FloatArray:
        return 1 / np.cos(angle / 2) ** 2
