"""The f-theta lens of NVIDIA's logs: a polynomial between angle and radius, in either direction, and a linear
stretch."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ..errors import short
from ..geometry import BoolArray, FloatArray
from .lens import EDGE, Lens, LensError, angle_and_heading, direction_of, is_number
from .monotonic import STEEPEST, Inverse, end_of_rise

MOST_COEFFICIENTS = 16
"""Largest number of coefficients of a polynomial."""
WIDEST_RADIUS = 20.0
"""Largest radius of an image, in focal lengths."""
FIT_POINTS = 512
"""Number of points at which the approximate one of a lens's two polynomials is fitted."""


@dataclass(frozen=True)
class FTheta(Lens):
    """One of two polynomials without a constant, coefficients of powers 1, 2, 3, ...: ``radius_from_angle`` in focal
    lengths for radians, or ``angle_from_radius``; the other direction is solved. ``linear`` (c, d, e) stretches the
    plane: ``x' = c x + d y``, ``y' = e x + y``. Valid while the polynomial rises, up to ``max_angle_deg``."""

    TYPE: ClassVar[str] = "f_theta"

    radius_from_angle: tuple[float, ...] = ()
    angle_from_radius: tuple[float, ...] = ()
    max_angle_deg: float = 180.0
    linear: tuple[float, ...] = (1.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        for name in ("radius_from_angle", "angle_from_radius", "linear"):
            value = getattr(self, name)
            if not isinstance(value, tuple) or len(value) > MOST_COEFFICIENTS or not all(map(is_number, value)):
                raise LensError(
                    f"{self.TYPE}: {name} must be at most {MOST_COEFFICIENTS} finite numbers, not "
                    f"{short(list(value) if isinstance(value, tuple) else value)}"
                )
        self.check_numbers("max_angle_deg")
        if not 0 < self.max_angle_deg <= 180:
            raise LensError(f"{self.TYPE}: max_angle_deg must lie above 0 and at most at 180, not {self.max_angle_deg}")
        if bool(self.radius_from_angle) == bool(self.angle_from_radius):
            raise LensError(f"{self.TYPE}: needs radius_from_angle or angle_from_radius, and not both")
        if len(self.linear) != 3 or not self._stretch > 1e-6:
            raise LensError(f"{self.TYPE}: linear must be c, d, e with c - d e above 0, not {short(list(self.linear))}")
        self.check_domain()

    @staticmethod
    def from_pixels(
        polynomial: Sequence[float],
        is_radius_from_angle: bool,
        max_angle_rad: float,
        linear: Sequence[float] = (1, 0, 0),
    ) -> tuple[float, FTheta]:
        """Return the focal length in pixels and the lens of a polynomial that has its radius in pixels: its
        coefficients from the constant on, which must be 0."""
        c = [float(x) for x in polynomial]
        if len(c) < 2 or c[0] != 0 or not all(map(math.isfinite, c)) or not c[1] > 0:
            raise LensError(f"{FTheta.TYPE}: the polynomial must begin with 0 and a number above 0, not {short(c[:2])}")
        stretch = tuple(float(x) for x in linear)
        degrees = min(180.0, math.degrees(max_angle_rad))
        if is_radius_from_angle:
            focal = c[1]
            return focal, FTheta(tuple(x / focal for x in c[1:]), (), degrees, stretch)
        focal = 1 / c[1]
        return focal, FTheta((), tuple(x * focal**power for power, x in enumerate(c[1:], 1)), degrees, stretch)

    def in_pixels(self, fx: float, fy: float, count: int) -> tuple[FloatArray, FloatArray, tuple[float, float, float]]:
        """Return both polynomials with the radius in pixels, and the linear stretch, of a camera with these focal
        lengths: pixels for radians, radians for pixels, coefficients of powers 1, 2, 3, ... The one that the lens does
        not have is fitted with ``count`` coefficients. Both axes are scaled by ``fy``; what fx is more goes into the
        stretch."""
        coefficients = np.array(self._coefficients)
        forward = bool(self.radius_from_angle)
        coefficients = coefficients * (fy if forward else fy ** -np.arange(1.0, 1 + len(coefficients)))
        angles = np.linspace(0, self.max_angle_rad * (1 - 1e-9), FIT_POINTS)
        plane, _ = FTheta(self.radius_from_angle, self.angle_from_radius, self.max_angle_deg).project(
            np.stack([np.sin(angles), np.zeros(FIT_POINTS), np.cos(angles)], -1)
        )
        pixels = plane[:, 0] * fy
        at, values = (pixels, angles) if forward else (angles, pixels)
        fitted = np.linalg.lstsq(np.vander(at / at[-1], count + 1, increasing=True)[:, 1:], values, rcond=None)[0]
        other = fitted / at[-1] ** np.arange(1, count + 1)
        c, d, e = self.linear
        stretch = (c * fx / fy, d * fx / fy, e)
        return (coefficients, other, stretch) if forward else (other, coefficients, stretch)

    @property
    def max_angle_rad(self) -> float:
        if self.radius_from_angle:
            return self._end
        return min(self._widest, float(self._polynomial(np.array([self._end]))[0]))

    @property
    def axis_slope(self) -> float:
        return self.radius_from_angle[0] if self.radius_from_angle else 1 / self.angle_from_radius[0]

    def project(self, points: FloatArray) -> tuple[FloatArray, BoolArray]:
        angle, x, y = angle_and_heading(points)
        valid = np.isfinite(points).all(-1) & (angle <= self.max_angle_rad * EDGE)
        angle = np.where(valid, angle, 0.0)
        radius = self._polynomial(angle) if self.radius_from_angle else self._inverse(angle)[0]
        c, d, e = self.linear
        x, y = radius * x, radius * y
        return np.where(valid[..., None], np.stack([c * x + d * y, e * x + y], -1), np.nan), valid

    def unproject(self, plane: FloatArray) -> FloatArray:
        c, d, e = self.linear
        u, v = plane[..., 0], plane[..., 1]
        with np.errstate(invalid="ignore"):
            x, y = (u - d * v) / self._stretch, (c * v - e * u) / self._stretch
        radius = np.hypot(x, y)
        if self.radius_from_angle:
            angle, valid = self._inverse(radius)
        else:
            valid = radius <= self._end * EDGE
            angle = self._polynomial(np.where(valid, radius, 0.0))
            valid = valid & (angle <= self.max_angle_rad * EDGE)
        return np.where(valid[..., None], direction_of(angle, x, y, radius), np.nan)

    @property
    def _stretch(self) -> float:
        c, d, e = self.linear
        return c - d * e

    @property
    def _widest(self) -> float:
        return min(math.radians(self.max_angle_deg), math.pi * (1 - 1e-6))

    @property
    def _coefficients(self) -> tuple[float, ...]:
        return self.radius_from_angle or self.angle_from_radius

    def _polynomial(self, at: FloatArray) -> FloatArray:
        out = np.zeros_like(at)
        for c in reversed(self._coefficients):
            out = (out + c) * at
        return out

    def _slope(self, at: FloatArray) -> FloatArray:
        out = np.zeros_like(at)
        for power in range(len(self._coefficients), 0, -1):
            out = out * at + power * self._coefficients[power - 1]
        return out

    @cached_property
    def _end(self) -> float:
        """End of the polynomial's argument."""
        if self.radius_from_angle:
            return end_of_rise(self._slope, self._widest, STEEPEST)
        return end_of_rise(self._slope, WIDEST_RADIUS)

    @cached_property
    def _inverse(self) -> Inverse:
        return Inverse(self._polynomial, self._slope, self._end)
