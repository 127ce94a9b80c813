"""Drops and flakes as a field that is the same for every sensor, at any time and in any process.

Particles of one class of sizes fall at one speed. In the frame that falls with them they stand still, one in each cell of
a lattice, in as many layers as the weather asks for: heavier rain adds particles and moves none. A hash of the seed, the
class, the layer and the cell gives a particle's place in its cell and its size.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry import BoolArray, FloatArray
from ..world.weather import Weather
from .atmosphere import Sizes, rain_sizes, snow_sizes

EDGES_MM = {"rain": (1.0, 1.4, 2.0, 2.8, 4.0, 6.0), "snow": (0.7, 1.0, 1.4, 2.0, 2.8, 4.0)}
"""Limits of the classes, melted diameters; smaller ones are part of the air."""
UNIT_RATE_MM_H = {"rain": 4.0, "snow": 0.8}
"""Rates at which a class has one layer, if a layer then has `LEAST_IN_LAYER` particles per m³."""
LEAST_IN_LAYER = 4.0
_MIX = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB], np.uint64)
_BITS = np.uint64(21)
_UNIT = 1.0 / (1 << 21)


class Particles(NamedTuple):
    """Positions (N, 3) in metres, world frame, and diameters (N,) in metres."""

    positions: FloatArray
    diameters_m: FloatArray


@dataclass(frozen=True)
class ParticleClass:
    """Particles of melted diameters from ``low_mm`` to ``high_mm``: ``layers`` of one in each cell of ``cell_m``, falling
    at ``speed_m_s``."""

    kind: str
    low_mm: float
    high_mm: float
    sizes: Sizes
    layers: float
    cell_m: float
    speed_m_s: float
    seed: int

    @property
    def largest_m(self) -> float:
        """Largest diameter, metres."""
        return float(self.sizes.diameter_mm(np.array(self.high_mm))) * 1e-3

    @property
    def extinction(self) -> float:
        """Extinction, 1/m, of particles of this class."""
        melted = self.low_mm + (np.arange(64) + 0.5) / 64 * (self.high_mm - self.low_mm)
        density = self.sizes.intercept * np.exp(-self.sizes.slope * melted) * (self.high_mm - self.low_mm)
        return float(np.mean(np.pi / 2 * density * self.sizes.diameter_mm(melted) ** 2)) * 1e-6

    def inside(
        self, low: FloatArray, high: FloatArray, time_s: float, near: Callable[[FloatArray, float], BoolArray]
    ) -> Iterator[Particles]:
        """Yield the particles at a time, layer by layer, whose cells lie in a box from ``low`` to ``high`` (3,), world
        frame, and are ``near``: a function of their middles (N, 3) and their outer radius."""
        fallen = np.array([0.0, 0.0, self.speed_m_s * time_s])
        first = np.floor((low + fallen) / self.cell_m).astype(np.int64)
        count = np.floor((high + fallen) / self.cell_m).astype(np.int64) - first + 1
        cells = np.indices(count).reshape(3, -1).T + first
        cells = cells[near((cells + 0.5) * self.cell_m - fallen, self.cell_m * math.sqrt(3) / 2)]
        for layer in range(math.ceil(self.layers)):
            positions, melted = self._in_layer(cells, layer)
            yield Particles(positions - fallen, self.sizes.diameter_mm(melted) * 1e-3)

    def _in_layer(self, cells: NDArray[np.int64], layer: int) -> tuple[FloatArray, FloatArray]:
        """Return positions (N, 3), in the falling frame, and melted diameters (N,), mm, of a layer's particles."""
        place = _hashed(cells, (self.seed, len(self.kind), round(self.low_mm * 1000), layer))
        more = _mixed(place)
        size = (more >> np.uint64(43)).astype(np.float64) * _UNIT
        if layer + 1 > self.layers:
            there = (more & np.uint64((1 << 21) - 1)).astype(np.float64) * _UNIT < self.layers - layer
            cells, place, size = cells[there], place[there], size[there]
        least, most = (math.exp(-self.sizes.slope * edge) for edge in (self.high_mm, self.low_mm))
        melted = -np.log(least + size * (most - least)) / self.sizes.slope
        return (cells + _units(place)) * self.cell_m, melted


def particle_classes(weather: Weather) -> Iterator[ParticleClass]:
    """Yield the classes of drops and flakes that a weather has."""
    for kind, rate, sizes_of in (("rain", weather.rain_mm_h, rain_sizes), ("snow", weather.snow_mm_h, snow_sizes)):
        if not rate:
            continue
        sizes, unit = sizes_of(rate), sizes_of(UNIT_RATE_MM_H[kind])
        edges = EDGES_MM[kind]
        for low, high in zip(edges, edges[1:], strict=False):
            in_unit = max(unit.count(low) - unit.count(high), LEAST_IN_LAYER)
            diameter_mm = float(sizes.diameter_mm(np.array((low + high) / 2)))
            yield ParticleClass(
                kind, low, high, sizes, (sizes.count(low) - sizes.count(high)) / in_unit, in_unit ** (-1 / 3),
                fall_speed(kind, diameter_mm), weather.seed,
            )  # fmt: skip


def fall_speed(kind: str, diameter_mm: float) -> float:
    """Return the speed, m/s, at which drops (Atlas et al. 1973) and flakes (aggregates of dendrites; Locatelli & Hobbs
    1974) fall."""
    if kind == "rain":
        return 9.65 - 10.3 * math.exp(-0.6 * diameter_mm)
    return 0.8 * diameter_mm**0.16


def hashed_units(cells: NDArray[np.int64], words: tuple[int, ...]) -> FloatArray:
    """Return three numbers (N, 3) between 0 and 1, without these, by a hash of cells (N, 3) and a few numbers."""
    return _units(_hashed(cells, words))


def _units(bits: NDArray[np.uint64]) -> FloatArray:
    """Return three numbers (N, 3) between 0 and 1 of 63 bits (N,) each."""
    parts = [(bits >> shift) & np.uint64((1 << 21) - 1) for shift in _BITS * np.arange(3, dtype=np.uint64)]
    return np.asarray((np.stack(parts, 1).astype(np.float64) + 0.5) * _UNIT)


def _mixed(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return 64 well mixed bits of each number (Steele et al. 2014, SplitMix64)."""
    x = x + _MIX[0]
    x = (x ^ (x >> np.uint64(30))) * _MIX[1]
    x = (x ^ (x >> np.uint64(27))) * _MIX[2]
    return x ^ (x >> np.uint64(31))


def _hashed(cells: NDArray[np.int64], words: tuple[int, ...]) -> NDArray[np.uint64]:
    """Return a hash (N,) of cells (N, 3) and a few numbers."""
    key = np.zeros(1, np.uint64)
    for word in words:
        key = _mixed(key + np.uint64(word))
    x = cells.astype(np.uint64)
    for axis in range(3):
        key = _mixed(key + x[:, axis] * _MIX[axis])
    return key
