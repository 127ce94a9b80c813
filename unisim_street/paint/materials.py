"""Appearance of a surface point: its colour, gloss and reflectivity, from where it lies on its part.

Patterns are procedural, without aliasing: tileable noise with a mip pyramid, soft steps and hashes.

Colours are linear Rec.709 albedos. ``SurfaceMaterial.glass`` marks what mirrors rather than scatters, which LiDAR
sees head-on alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
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


@dataclass(frozen=True)
class SurfacePoints:
    """Surface points of one part. part (N, 3) in the part's frame, asset (N, 3) in its asset's, normal (N, 3)
    in the part's.

    footprint (N,): metres that a sample covers across the ray; along the surface it is stretched by 1 / cosine (N,).
    time_s (N,): when they are seen; None at the drive's start.
    """

    part: FloatArray
    asset: FloatArray
    normal: FloatArray
    footprint: FloatArray
    cosine: FloatArray
    time_s: FloatArray | None = None

    @property
    def spread(self) -> FloatArray:
        """One number for both ways of the footprint (N,): their geometric mean."""
        return np.asarray(self.footprint / np.sqrt(np.maximum(self.cosine, 0.02)))


@dataclass(frozen=True)
class SurfaceMaterial:
    """albedo (N, 3) linear; gloss, glass, reflectivity (N,) in 0..1; emitted (N, 3) linear light, None for none."""

    albedo: FloatArray
    gloss: FloatArray
    glass: FloatArray
    reflectivity: FloatArray
    emitted: FloatArray | None = None


def surface(
    albedo: FloatArray,
    gloss: FloatArray | float = 0.0,
    glass: FloatArray | float = 0.0,
    reflectivity: FloatArray | None = None,
) -> SurfaceMaterial:
    """A surface of albedo (N, 3); reflectivity at the LiDAR's wavelength follows the albedo where it is not given."""
    n = len(albedo)
    albedo = np.clip(albedo, 0.0, 1.0)
    if reflectivity is None:
        reflectivity = 0.04 + 0.8 * albedo @ np.array([0.6, 0.3, 0.1])
    return SurfaceMaterial(albedo, np.broadcast_to(gloss, n), np.broadcast_to(glass, n), reflectivity)


@dataclass(frozen=True)
class Finish:
    """Reflection parameters of a surface for a path tracer, beside its colour; where a surface is glass
    (`SurfaceMaterial.glass`) it mirrors as glass does.

    roughness, metallic, coat (clear lacquer) in 0..1; grain_m: size of the bumps that roughen it, 0 for none, and their
    height grain_height_m; translucent: share of light that shines through.
    """

    roughness: float = 0.8
    metallic: float = 0.0
    coat: float = 0.0
    grain_m: float = 0.0
    grain_height_m: float = 0.0
    translucent: float = 0.0


class Material(ABC):
    """A rule that paints points."""

    @property
    def finish(self) -> Finish:
        """How the painted surface reflects."""
        return Finish()

    @abstractmethod
    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        """The surface at points."""


@dataclass(frozen=True)
class Plain(Material):
    """One colour, mottled a little."""

    color: str
    mottle: float = 0.06
    gloss: float = 0.0

    @property
    def finish(self) -> Finish:
        return Finish(0.45 if self.gloss else 0.85)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, y, z = p.asset.T
        tone = noises()["blotch"](x * 3 + 1.7 * z, y * 3 + 2.3 * z, p.spread * 3)
        return surface(linear(self.color) * (1 + self.mottle * tone)[:, None], self.gloss)


@dataclass(frozen=True)
class Bulb(Material):
    """A lamp behind a lens of a colour. From ``times_s`` (K) on it is ``lit`` (K), as the first before."""

    name: str
    lens: str
    light: tuple[float, float, float]
    times_s: tuple[float, ...] = (0.0,)
    lit: tuple[bool, ...] = (False,)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        time_s = np.zeros(len(p.part)) if p.time_s is None else p.time_s
        row = np.maximum(np.searchsorted(self.times_s, time_s, "right") - 1, 0)
        unlit = surface(np.tile(linear(self.lens), (len(p.part), 1)), 0.03)
        return replace(unlit, emitted=np.array(self.lit)[row, None] * np.array(self.light))


@dataclass(frozen=True)
class Foliage(Material):
    """Leaves: blotches of light and dark green."""

    color: str = "#4e6336"

    @property
    def finish(self) -> Finish:
        return Finish(0.55, translucent=0.5)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        x, y, z = p.asset.T
        leaf = noises()["leaf"]
        # seen along the axis nearest to the normal, so that no leaf is smeared round a clump
        axis = np.abs(p.normal).argmax(1)
        across = np.where(axis == 0, y, x + 0.9 * axis)
        tone = leaf(across, np.where(axis == 2, y, z), p.spread)
        base = linear(self.color) * np.clip(1 + 0.5 * tone, 0.25, 2.2)[:, None]
        warm = np.array([0.025, 0.025, 0.0]) * np.clip(tone, 0, 2)[:, None]
        return surface(base + warm, reflectivity=np.clip(0.35 + 0.12 * tone, 0.1, 0.7))


@dataclass(frozen=True)
class Banded(Material):
    """Bands of a second colour along z between ``bands`` (low, high), such as a cone's sleeve or a
    bollard's stripes."""

    color: str
    band_color: str
    bands: tuple[tuple[float, float], ...]
    gloss: float = 0.02
    retro: float = 0.9

    @property
    def finish(self) -> Finish:
        return Finish(0.5)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        z = p.part[:, 2]
        inside = np.zeros(len(z))
        for low, high in self.bands:
            inside = np.maximum(inside, cover(np.maximum(low - z, z - high), p.footprint))
        albedo = mix(linear(self.color), linear(self.band_color), inside)
        base = surface(albedo, self.gloss)
        return surface(albedo, self.gloss, reflectivity=base.reflectivity * (1 - inside) + self.retro * inside)


@dataclass(frozen=True)
class Sign(Material):
    """A round sign across the part's x and y, its face towards z: rim, field and bar."""

    field: str
    rim: str
    bar: str | None
    radius: float

    @property
    def finish(self) -> Finish:
        return Finish(0.35)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        r = np.hypot(p.part[:, 0], p.part[:, 1])
        albedo = mix(linear(self.field), linear(self.rim), 1 - cover(r - 0.8 * self.radius, p.footprint))
        if self.bar is not None:
            bar = rectangle(p.part[:, 0], p.part[:, 1], 0.6 * self.radius, 0.16 * self.radius)
            albedo = mix(albedo, linear(self.bar), cover(bar, p.footprint))
        back = p.normal[:, 2] < 0.5
        albedo[back] = linear("#8d9194")
        return surface(albedo, 0.03, reflectivity=np.where(back, 0.3, 0.9))


@dataclass(frozen=True)
class Slats(Material):
    """Boards or louvres along the part's x, such as a bench, a crate or a roller shutter."""

    color: str
    pitch: float = 0.12

    @property
    def finish(self) -> Finish:
        return Finish(0.65)

    def __call__(self, p: SurfacePoints) -> SurfaceMaterial:
        across = np.where(np.abs(p.normal[:, 2]) > 0.7, p.part[:, 1], p.part[:, 2])
        gap = stripes(across, self.pitch, 0.18 * self.pitch, p.spread)
        board = np.floor(across / self.pitch + 0.5).astype(np.int64)
        tone = (
            1 + 0.18 * (hashed(board, 7) - 0.5) + 0.05 * noises()["grain"](p.part[:, 0] * 0.3, across * 2.0, p.spread)
        )
        return surface(linear(self.color) * (tone * (1 - 0.6 * gap))[:, None])
