"""The ideal pinhole: straight lines stay straight."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..geometry import BoolArray, FloatArray
from .lens import Lens


@dataclass(frozen=True)
class Pinhole(Lens):
    """A pinhole without distortion. Its valid domain is what lies before the camera's plane."""

    TYPE: ClassVar[str] = "pinhole"

    @property
    def max_angle_rad(self) -> float:
        """Less than a right angle."""
        return math.pi / 2

    @property
    def axis_slope(self) -> float:
        """1: see `Lens.axis_slope`."""
        return 1.0

    def project(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        """See `Lens.project`."""
        z = points[..., 2]
        valid = (z > 0) & np.isfinite(points).all(-1)
        plane = points[..., :2] / np.where(valid, z, 1.0)[..., None]
        return np.where(valid[..., None], plane, np.nan), valid

    def unproject(self, plane: FloatArray) -> FloatArray:
        """See `Lens.unproject`."""
        x, y = plane[..., 0], plane[..., 1]
        length = np.sqrt(x * x + (y * y + 1))
        with np.errstate(invalid="ignore"):
            return np.stack([x / length, y / length, 1 / length], -1)
