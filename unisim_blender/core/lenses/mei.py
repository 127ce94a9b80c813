"""Mei's model, as KITTI-360's fisheyes have it: onto a unit sphere, from a point off its centre onto a plane, then
distorted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..geometry import BoolArray, FloatArray
from .lens import EDGE, LEAST_SLOPE, Lens, LensError
from .plane_distortion import PlaneDistortion

WIDEST_RADIUS = 10.0
"""Largest radius of an image, on the plane before distortion."""


@dataclass(frozen=True)
class Mei(Lens):
    """``m = (x, y) / (z + xi)`` of unit directions, then radial (k1, k2) and tangential (p1, p2) distortion.
    KITTI-360's gamma1, gamma2, u0, v0 are the camera's fx, fy, cx, cy.

    Valid where m rises with the angle (``cos(angle) > -xi``, or ``-1 / xi`` where xi is above 1) and the distortion is
    one to one."""

    TYPE: ClassVar[str] = "mei"

    xi: float = 1.0
    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0

    def __post_init__(self) -> None:
        self.check_numbers("xi", "k1", "k2", "p1", "p2")
        if not 0 <= self.xi <= 100:
            raise LensError(f"{self.TYPE}: xi must lie between 0 and 100, not {self.xi}")
        self.check_domain()

    @cached_property
    def distortion(self) -> PlaneDistortion:
        """The distortion of the plane m."""
        xi, farthest = self.xi, WIDEST_RADIUS
        if xi > 1:
            # beyond this angle the sphere turns away; at its very edge m stands still
            cosine = -1 / xi + LEAST_SLOPE * (1 + 1 / xi)
            farthest = math.sqrt(1 - cosine * cosine) / (cosine + xi)
        return PlaneDistortion((self.k1, self.k2, 0, 0, 0, 0), (self.p1, self.p2), (0, 0, 0, 0), farthest)

    @cached_property
    def _end(self) -> float:
        x, _, z = self._from_plane(np.array([self.distortion.radius]), np.zeros(1))
        return math.atan2(float(x[0]), float(z[0]))

    @property
    def max_angle_rad(self) -> float:
        return self._end

    @property
    def axis_slope(self) -> float:
        return 1 / (1 + self.xi)

    def project(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        # by its largest component first: no square of a point is too large or too small for a float64
        largest = np.abs(points).max(-1)
        known = np.isfinite(largest) & (largest > 0)
        scaled = np.where(known[..., None], points, (0.0, 0.0, 1.0)) / np.where(known, largest, 1.0)[..., None]
        x, y, z = np.moveaxis(scaled / np.sqrt((scaled * scaled).sum(-1))[..., None], -1, 0)
        valid = known & (np.arctan2(np.hypot(x, y), z) <= self._end * EDGE)
        below = np.where(valid, z + self.xi, 1.0)
        u, v = self.distortion.distort(np.where(valid, x / below, 0.0), np.where(valid, y / below, 0.0))
        return np.where(valid[..., None], np.stack([u, v], -1), np.nan), valid

    def unproject(self, plane: FloatArray) -> FloatArray:
        x, y, valid = self.distortion.undistort(plane[..., 0], plane[..., 1])
        return np.where(valid[..., None], np.stack(self._from_plane(x, y), -1), np.nan)

    def _from_plane(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the direction of a point of the plane: where its ray hits the sphere."""
        m2 = x * x + y * y
        along = (self.xi + np.sqrt(np.maximum(1 + (1 - self.xi * self.xi) * m2, 0.0))) / (1 + m2)
        return along * x, along * y, along - self.xi
