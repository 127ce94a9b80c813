"""The route as a smooth curve by its arc length, and places along and across it (Frenet's frame)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import splev, splprep

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.geometry import FloatArray

SPACING_M = 0.5
SMOOTH_M = 0.02
"""How far the curve may lie from the route's points, root mean square."""


@dataclass(frozen=True, eq=False)
class Route:
    """Points of a curve (N,), `SPACING_M` apart: arc length, place, heading (not wrapped) and curvature. It goes on straight at
    both ends. Across it, left is positive."""

    s_m: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    heading_rad: FloatArray
    curvature: FloatArray

    @staticmethod
    def through(points: FloatArray) -> Route:
        """Return the smoothed curve along points (P, 2), in order. Raises `UnisimError` for fewer than two places."""
        steps = np.linalg.norm(np.diff(points, axis=0), axis=-1)
        kept = points[np.append(True, steps > 1e-3)]
        if len(kept) < 2:
            raise UnisimError("a route has at least two places")
        arc = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(kept, axis=0), axis=-1)))
        degree = min(3, len(kept) - 1)
        spline, _ = splprep(list(kept.T), u=arc, k=degree, s=len(kept) * SMOOTH_M**2 if degree == 3 else 0.0)
        u = np.linspace(0.0, arc[-1], max(int(arc[-1] / SPACING_M) + 1, 2))
        x, y = splev(u, spline)
        dx, dy = splev(u, spline, 1)
        ddx, ddy = splev(u, spline, 2) if degree > 1 else (np.zeros_like(u), np.zeros_like(u))
        speed = np.hypot(dx, dy)
        s = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
        return Route(s, x, y, np.unwrap(np.arctan2(dy, dx)), (dx * ddy - dy * ddx) / speed**3)

    def project(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Return where a place is along and across the route."""
        i = int(np.argmin(np.hypot(self.x_m - x_m, self.y_m - y_m)))
        h = self.heading_rad[i]
        dx, dy = x_m - self.x_m[i], y_m - self.y_m[i]
        along = float(np.cos(h) * dx + np.sin(h) * dy)
        inside = -SPACING_M <= along <= SPACING_M or i in (0, len(self.s_m) - 1)
        s = float(self.s_m[i] + (along if inside else 0.0))
        px, py, heading, _ = (float(one) for one in self.at(np.array(s)))
        return s, float(np.cos(heading) * (y_m - py) - np.sin(heading) * (x_m - px))

    def at(self, s_m: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return x, y, heading and curvature (...) at arc lengths (...)."""
        x, y, heading, curvature = (
            np.interp(s_m, self.s_m, one) for one in (self.x_m, self.y_m, self.heading_rad, self.curvature)
        )
        beyond = s_m - np.clip(s_m, self.s_m[0], self.s_m[-1])
        x, y = x + beyond * np.cos(heading), y + beyond * np.sin(heading)
        return x, y, heading, np.where(beyond == 0, curvature, 0.0)

    def place(self, s_m: FloatArray, d_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return x, y (...) of places along and across the route (...)."""
        x, y, heading, _ = self.at(s_m)
        return x - d_m * np.sin(heading), y + d_m * np.cos(heading)
