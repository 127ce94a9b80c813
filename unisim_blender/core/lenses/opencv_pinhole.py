"""OpenCV's pinhole: rational radial (k1 to k6), tangential (p1, p2) and thin prism (s1 to s4) distortion."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..geometry import BoolArray, FloatArray
from .lens import EDGE, Lens
from .plane_distortion import PlaneDistortion

WIDEST_RAD = math.radians(89.0)


@dataclass(frozen=True)
class OpenCVPinhole(Lens):
    """OpenCV's ``distCoeffs``, in its order k1 k2 p1 p2 k3 k4 k5 k6 s1 s2 s3 s4 (a tilted sensor, tau_x and tau_y, is
    not modelled). Valid where `plane_distortion` is, at most 89 degrees from the optical axis."""

    TYPE: ClassVar[str] = "opencv_pinhole"

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0

    def __post_init__(self) -> None:
        self.check_numbers("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
        self.check_domain()

    @cached_property
    def distortion(self) -> PlaneDistortion:
        """The distortion of the plane at distance 1."""
        k = self.k1, self.k2, self.k3, self.k4, self.k5, self.k6
        return PlaneDistortion(k, (self.p1, self.p2), (self.s1, self.s2, self.s3, self.s4), math.tan(WIDEST_RAD))

    @property
    def max_angle_rad(self) -> float:
        return math.atan(self.distortion.radius)

    @property
    def axis_slope(self) -> float:
        return 1.0

    def project(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        z = points[..., 2]
        ahead = (z > 0) & np.isfinite(points).all(-1)
        safe = np.where(ahead, z, 1.0)
        x, y = points[..., 0] / safe, points[..., 1] / safe
        valid = ahead & (np.hypot(x, y) <= self.distortion.radius * EDGE)
        x, y = self.distortion.distort(np.where(valid, x, 0.0), np.where(valid, y, 0.0))
        return np.where(valid[..., None], np.stack([x, y], -1), np.nan), valid

    def unproject(self, plane: FloatArray) -> FloatArray:
        x, y, valid = self.distortion.undistort(plane[..., 0], plane[..., 1])
        length = np.sqrt(x * x + (y * y + 1))
        return np.where(valid[..., None], np.stack([x / length, y / length, 1 / length], -1), np.nan)
