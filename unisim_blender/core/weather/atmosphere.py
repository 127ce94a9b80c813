"""Extinction and backscatter of fog, rain and snow.

Fog: Koschmieder (1924). Rain: drops of Marshall & Palmer (1948). Snow: flakes of Gunn & Marshall (1958), whose density is
that of Brandes et al. (2007). What is larger than a wavelength removes light from twice its own area.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..geometry import FloatArray
from ..world.weather import Weather

CONTRAST_THRESHOLD = 0.02
"""Contrast of a black target against the horizon at the visibility: extinction is 3.912 / visibility."""
LIDAR_RATIO_SR = {"fog": math.log(20) / 0.046, "rain": 18.8, "snow": 20.0}
"""Extinction / backscatter, sr: fog as of Rasshofer et al. (2011), used by Hahner et al. (2021); drops, O'Connor et al.
(2004); flakes are of ice clouds' order."""
SNOW_DENSITY = 0.178
"""Density of a flake of 1 mm, g/cm³; that of larger ones is proportional to its diameter to the power -0.922."""


@dataclass(frozen=True)
class Sizes:
    """Numbers of particles by diameter: ``intercept`` exp(-``slope`` x) per m³ and mm, where x, mm, is that of the melted
    particle, whose own diameter is ``scale`` x^``power``."""

    intercept: float
    slope: float
    scale: float = 1.0
    power: float = 1.0

    def count(self, least_mm: float) -> float:
        """Return the number of particles per m³ with a melted diameter above ``least_mm``."""
        return self.intercept / self.slope * math.exp(-self.slope * least_mm)

    def diameter_mm(self, melted_mm: FloatArray) -> FloatArray:
        """Return the diameters (...), mm, of particles by their melted ones (...)."""
        return np.asarray(self.scale * melted_mm**self.power)

    @property
    def extinction(self) -> float:
        """Extinction, 1/m: the integral of 2 (pi/4) D²."""
        moment = self.intercept * self.scale**2 * math.gamma(2 * self.power + 1) / self.slope ** (2 * self.power + 1)
        return math.pi / 2 * moment * 1e-6


def rain_sizes(rate_mm_h: float) -> Sizes:
    """Return the sizes of drops of rain (Marshall & Palmer 1948)."""
    return Sizes(8000.0, 4.1 * rate_mm_h**-0.21)


def snow_sizes(rate_mm_h: float) -> Sizes:
    """Return the sizes of flakes (Gunn & Marshall 1958) of a rate of liquid water; their mass has the density of Brandes
    et al. (2007): x³ = `SNOW_DENSITY` D^2.078."""
    power = 3 / (3 - 0.922)
    return Sizes(3800.0 * rate_mm_h**-0.87, 2.55 * rate_mm_h**-0.48, SNOW_DENSITY ** (-power / 3), power)


def extinctions(weather: Weather) -> dict[str, float]:
    """Return the extinction, 1/m, of what is in the air, by `LIDAR_RATIO_SR`'s names."""
    return {
        "fog": -math.log(CONTRAST_THRESHOLD) / weather.visibility_m,
        "rain": rain_sizes(weather.rain_mm_h).extinction if weather.rain_mm_h else 0.0,
        "snow": snow_sizes(weather.snow_mm_h).extinction if weather.snow_mm_h else 0.0,
    }


def backscatter(weather: Weather) -> float:
    """Return the backscatter of fog, 1/(m sr). Drops and flakes return beams one by one."""
    return extinctions(weather)["fog"] / LIDAR_RATIO_SR["fog"]


def transmittance(extinction: float, depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the transmittance (...) over depths (...), metres: exp(-extinction depth), 0 at infinity, where
    there is extinction, and 1 where there is none."""
    if not extinction:
        return np.ones(depth_m.shape, np.float32)
    out = np.multiply(depth_m, np.float32(-extinction), dtype=np.float32)
    return np.exp(out, out=out)
