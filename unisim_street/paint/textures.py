"""Procedural patterns without aliasing: tileable noise with a mip pyramid, soft steps and hashes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray


class Noise:
    """Tileable noise of zero mean and unit deviation, filtered to the footprint it is asked at.

    Its spectrum is ``frequency ** -roll`` between wavelengths of ``longest_m`` and ``shortest_m``; a tile is ``tile_m``
    wide.
    """

    def __init__(
        self, seed: int, tile_m: float, longest_m: float, shortest_m: float, roll: float, size: int = 512
    ) -> None:
        rng = np.random.default_rng(seed)
        cycles = np.fft.fftfreq(size, 1.0 / size)
        frequency = np.hypot(cycles[:, None], cycles[None, : size // 2 + 1]) / tile_m
        band = (frequency >= 1.0 / longest_m) & (frequency <= 1.0 / shortest_m)
        amplitude = np.where(band, np.maximum(frequency, 1e-9) ** -roll, 0.0)
        spectrum = np.fft.rfft2(rng.standard_normal((size, size))) * amplitude
        image = np.fft.irfft2(spectrum, (size, size))
        image = (image / image.std()).astype(np.float32)
        self.tile_m, self.size, levels = tile_m, size, [image]
        while levels[-1].shape[0] > 1:
            half = levels[-1].shape[0] // 2
            levels.append(levels[-1].reshape(half, 2, half, 2).mean((1, 3)))
        self._texels = np.concatenate([level.ravel() for level in levels])
        sizes = np.array([level.shape[0] for level in levels])
        self._starts = np.concatenate([[0], np.cumsum(sizes[:-1] ** 2)])
        self._sizes = sizes

    def __call__(self, u: FloatArray, v: FloatArray, footprint_m: FloatArray) -> NDArray[np.float32]:
        """Values (N,) at u, v (N,) in metres, averaged over about ``footprint_m`` (N,): trilinear."""
        level = np.log2(np.maximum(footprint_m * self.size / self.tile_m, 1.0))
        level = np.minimum(level, len(self._sizes) - 1.001)
        lower = level.astype(np.int64)
        fraction = (level - lower).astype(np.float32)
        u, v = u / self.tile_m, v / self.tile_m
        return np.asarray(self._bilinear(u, v, lower) * (1 - fraction) + self._bilinear(u, v, lower + 1) * fraction)

    def _bilinear(self, u: FloatArray, v: FloatArray, level: NDArray[np.int64]) -> NDArray[np.float32]:
        size, start = self._sizes[level], self._starts[level]
        x, y = u * size - 0.5, v * size - 0.5
        column, row = np.floor(x), np.floor(y)
        fx, fy = (x - column).astype(np.float32), (y - row).astype(np.float32)
        mask = size - 1
        c0, r0 = column.astype(np.int64) & mask, row.astype(np.int64) & mask
        c1, r1 = (c0 + 1) & mask, (r0 + 1) & mask
        top, bottom = start + r0 * size, start + r1 * size
        t = self._texels
        upper = t[top + c0] * (1 - fx) + t[top + c1] * fx
        under = t[bottom + c0] * (1 - fx) + t[bottom + c1] * fx
        return np.asarray(upper * (1 - fy) + under * fy)


@lru_cache(maxsize=1)
def noises() -> dict[str, Noise]:
    """The street's stock of noise: ``grain`` (asphalt, plaster), ``blotch`` (stains), ``leaf`` (foliage), ``cloud``."""
    return {
        "grain": Noise(1, 6.0, 0.6, 0.03, 0.8),
        "blotch": Noise(2, 24.0, 6.0, 0.25, 1.6, 256),
        "leaf": Noise(3, 4.0, 0.7, 0.08, 0.9, 256),
        "cloud": Noise(4, 16.0, 8.0, 0.25, 2.1, 256),
    }


def cover(distance: FloatArray, footprint_m: FloatArray) -> FloatArray:
    """How much (N,) of a footprint lies inside an edge at signed ``distance`` (N,), negative inside: 0..1."""
    return np.asarray(np.clip(0.5 - distance / np.maximum(footprint_m, 1e-4), 0.0, 1.0))


def stripes(x: FloatArray, pitch: float, width: float, footprint_m: FloatArray) -> FloatArray:
    """Coverage (N,) of lines ``width`` wide that repeat every ``pitch`` about x = 0; it fades to its
    mean when too fine."""
    distance = np.abs((x / pitch + 0.5) % 1.0 - 0.5) * pitch - width / 2
    fade = np.clip(footprint_m / pitch * 1.5 - 0.5, 0.0, 1.0)
    peak = np.minimum(1.0, width / np.maximum(footprint_m, 1e-9))
    return np.asarray(cover(distance, footprint_m) * peak * (1 - fade) + width / pitch * fade)


def rectangle(x: FloatArray, y: FloatArray, half_x: FloatArray | float, half_y: FloatArray | float) -> FloatArray:
    """Signed distance (N,) to a rectangle about the origin, negative inside (its inside is the larger
    of the two axes')."""
    dx, dy = np.abs(x) - half_x, np.abs(y) - half_y
    outside = np.hypot(np.maximum(dx, 0), np.maximum(dy, 0))
    return np.asarray(outside + np.minimum(np.maximum(dx, dy), 0))


def hashed(*keys: NDArray[np.int64] | int) -> FloatArray:
    """A pseudo-random number in [0, 1) for each tuple of integers (N,): SplitMix64's finaliser."""
    state = np.zeros(1, np.uint64)
    with np.errstate(over="ignore"):
        for key in keys:
            state = (state + np.asarray(key, np.int64).astype(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
            state = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
            state = (state ^ (state >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
            state = state ^ (state >> np.uint64(31))
    return np.asarray((state >> np.uint64(11)).astype(np.float64) / 2.0**53)


def linear(srgb_hex: str) -> FloatArray:
    """Linear RGB (3,) of a colour such as "#c8a27a"."""
    value = np.array([int(srgb_hex[i : i + 2], 16) for i in (1, 3, 5)]) / 255.0
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def mix(a: FloatArray, b: FloatArray, weight: FloatArray) -> FloatArray:
    """a (N, 3) or (3,) towards b by weight (N,): (N, 3)."""
    w = weight[:, None]
    return np.asarray(a * (1 - w) + b * w)
