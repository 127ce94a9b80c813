"""Distortion of a plane: rational radial, tangential and thin prism terms, as OpenCV's pinhole and MEI's model have
them.

``x' = x R + 2 p1 x y + p2 (r2 + 2 x2) + s1 r2 + s2 r4``, ``y' = y R + p1 (r2 + 2 y2) + 2 p2 x y + s3 r2 + s4 r4`` with
``R = (1 + k1 r2 + k2 r4 + k3 r6) / (1 + k4 r2 + k5 r4 + k6 r6)``.

The valid domain is the largest disc on which the symmetric part of the Jacobian is positive definite: on a convex set
that makes the distortion one to one. Without tangential terms it is the disc on which the radius rises.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..geometry import BoolArray, FloatArray
from .lens import EDGE, LEAST_SLOPE
from .monotonic import BISECTIONS, Inverse, end_of_rise

HEADINGS = 90
RADII = 1024
NEWTON = 6
"""Number of Newton steps, fixed as in `monotonic`."""
RESCUE = 60
CLOSE = 1e-12
FARTHEST = 64.0
"""Largest distorted radius of the valid domain, in focal lengths: beside a pole of the denominator it has no bound."""


@dataclass(frozen=True)
class PlaneDistortion:
    """The distortion on the disc of radius ``farthest`` at most."""

    k: tuple[float, float, float, float, float, float]
    p: tuple[float, float]
    s: tuple[float, float, float, float]
    farthest: float

    @cached_property
    def radius(self) -> float:
        """Radius of the disc that is the valid domain."""
        end = end_of_rise(self._radial_slope, self.farthest)
        if self.is_radial or end == 0:
            return end
        heading = np.linspace(0, 2 * np.pi, HEADINGS, endpoint=False)
        cosine, sine = np.cos(heading), np.sin(heading)

        def least(radius: FloatArray) -> FloatArray:
            """Return the smallest eigenvalue on circles (N,) of the Jacobian's symmetric part."""
            a, b, c, d = self._jacobian(radius[:, None] * cosine, radius[:, None] * sine)
            return np.asarray(((a + d) / 2 - np.hypot((a - d) / 2, (b + c) / 2)).min(1))

        at = np.linspace(0.0, end, RADII)
        low = ~(least(at) > LEAST_SLOPE)
        if not low.any():
            return end
        first = int(low.argmax())
        if first == 0:
            return 0.0
        inside, outside = float(at[first - 1]), float(at[first])
        for _ in range(BISECTIONS):
            middle = (inside + outside) / 2
            if least(np.array([middle]))[0] > LEAST_SLOPE:
                inside = middle
            else:
                outside = middle
        return inside

    @property
    def is_radial(self) -> bool:
        """Whether it has neither tangential nor prism terms."""
        return not any(self.p) and not any(self.s)

    def distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distorted points (...), (...) of points x, y (...), in focal lengths."""
        (p1, p2), (s1, s2, s3, s4) = self.p, self.s
        r2 = x * x + y * y
        factor = self._factor(r2)
        if self.is_radial:
            return x * factor, y * factor
        u = x * factor + 2 * p1 * x * y + p2 * (r2 + 2 * x * x) + s1 * r2 + s2 * r2 * r2
        v = y * factor + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y + s3 * r2 + s4 * r2 * r2
        return u, v

    def undistort(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Return the points (...), (...) of the valid domain whose distortion is u, v (...), and whether (...) there is
        one."""
        distance = np.hypot(u, v)
        known = np.isfinite(distance)
        distance, u, v = (np.where(known, a, 0.0) for a in (distance, u, v))
        r, inside = self._inverse(np.minimum(distance, self._inverse.most))
        ratio = r / np.where(distance > 0, distance, 1.0)
        x, y = u * ratio, v * ratio
        if self.is_radial:
            return x, y, known & inside & (distance <= self._inverse.most * EDGE)
        for _ in range(NEWTON):
            x, y, _ = self._step(x, y, u, v)
        missed = self._miss(x, y, u, v)
        lost = known & ~(missed < CLOSE * (1 + distance)) & (distance <= self._reach(u, v))
        if lost.any():
            x[lost], y[lost] = self._rescued(x[lost], y[lost], u[lost], v[lost])
            missed = self._miss(x, y, u, v)
        on_disc = np.hypot(x, y) <= self.radius * EDGE
        return x, y, known & on_disc & (missed < 100 * CLOSE * (1 + distance))

    @cached_property
    def _inverse(self) -> Inverse:
        return Inverse(lambda r: r * self._factor(r * r), self._radial_slope, self.radius)

    def _step(
        self, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, damping: FloatArray | float = 1.0
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (x, y) after a step of Newton's method, kept on the disc, and the distance by which (x, y) missed."""
        du, dv = self.distort(x, y)
        du, dv = du - u, dv - v
        a, b, c, d = self._jacobian(x, y)
        area = a * d - b * c
        area = np.where(np.abs(area) > 1e-12, area, 1e-12)
        x, y = x - damping * (d * du - b * dv) / area, y - damping * (a * dv - c * du) / area
        far = np.hypot(x, y)
        back = np.where(far > self.radius, self.radius / np.where(far > 0, far, 1.0), 1.0)
        return x * back, y * back, np.hypot(du, dv)

    def _rescued(self, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Solve with steps that are halved until they lessen the miss. A point that is solved takes no further step, so
        that the others do not matter to it."""
        for _ in range(RESCUE):
            missed = self._miss(x, y, u, v)
            open_ = np.flatnonzero(~(missed < CLOSE * (1 + np.hypot(u, v))))
            if not len(open_):
                break
            part = x[open_], y[open_], u[open_], v[open_]
            x[open_], y[open_] = self._halved(*part, missed[open_])
        return x, y

    def _halved(
        self, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray, missed: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        damping, best_x, best_y, best = 1.0, x, y, missed
        for _ in range(10):
            to_x, to_y, _ = self._step(x, y, u, v, damping)
            there = self._miss(to_x, to_y, u, v)
            better = there < best
            best_x = np.where(better, to_x, best_x)
            best_y = np.where(better, to_y, best_y)
            best = np.where(better, there, best)
            damping /= 2
        return best_x, best_y

    def _reach(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """Return the radius, slightly enlarged, of the image of the disc in the heading of (u, v)."""
        heading = np.linspace(-np.pi, np.pi, 8 * HEADINGS)
        x, y = self.distort(self.radius * np.cos(heading), self.radius * np.sin(heading))
        at = np.arctan2(y, x)
        order = np.argsort(at)
        return np.asarray(1.01 * np.interp(np.arctan2(v, u), at[order], np.hypot(x, y)[order], period=2 * np.pi))

    def _miss(self, x: FloatArray, y: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
        at_u, at_v = self.distort(x, y)
        return np.asarray(np.hypot(at_u - u, at_v - v))

    def _factor(self, r2: FloatArray) -> FloatArray:
        k1, k2, k3, k4, k5, k6 = self.k
        above = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return np.asarray(above / (1 + r2 * (k4 + r2 * (k5 + r2 * k6))) if k4 or k5 or k6 else above)

    def _factor_slope(self, r2: FloatArray) -> FloatArray:
        """Return the factor's derivative by r2."""
        k1, k2, k3, k4, k5, k6 = self.k
        above, rise = 1 + r2 * (k1 + r2 * (k2 + r2 * k3)), k1 + r2 * (2 * k2 + r2 * 3 * k3)
        if not (k4 or k5 or k6):
            return rise
        below, sink = 1 + r2 * (k4 + r2 * (k5 + r2 * k6)), k4 + r2 * (2 * k5 + r2 * 3 * k6)
        return np.asarray((rise * below - above * sink) / (below * below))

    def _radial_slope(self, r: FloatArray) -> FloatArray:
        k4, k5, k6 = self.k[3:]
        r2 = r * r
        # behind a pole of the denominator nothing is an image; the factor must not turn the image over either
        factor = self._factor(r2)
        slope = factor + 2 * r2 * self._factor_slope(r2)
        sound = (1 + r2 * (k4 + r2 * (k5 + r2 * k6)) > 1e-6) & (factor > 0) & (r * factor < FARTHEST)
        return np.where(sound, slope, -1.0)

    def _jacobian(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """du/dx, du/dy, dv/dx, dv/dy."""
        (p1, p2), (s1, s2, s3, s4) = self.p, self.s
        r2 = x * x + y * y
        factor, slope = self._factor(r2), self._factor_slope(r2)
        prism_u, prism_v = 2 * (s1 + 2 * s2 * r2), 2 * (s3 + 2 * s4 * r2)
        cross = 2 * x * y * slope
        return (
            factor + 2 * x * x * slope + 2 * p1 * y + 6 * p2 * x + prism_u * x,
            cross + 2 * p1 * x + 2 * p2 * y + prism_u * y,
            cross + 2 * p1 * x + 2 * p2 * y + prism_v * x,
            factor + 2 * y * y * slope + 6 * p1 * y + 2 * p2 * x + prism_v * y,
        )
