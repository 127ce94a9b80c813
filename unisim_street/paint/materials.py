"""What a surface point looks like: its colour, gloss and reflectivity, from where it lies on its part.

Colours are linear Rec.709 albedos. ``SurfaceMaterial.glass`` marks what mirrors rather than scatters, which LiDAR
sees head-on alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from unisim_blender.core.geometry import FloatArray

from .textures import cover, hashed, linear, mix, noises, rectangle, stripes


@dataclass(frozen=True)
class SurfacePoints:
    """Surface points of one part. part (N, 3) in the part's frame, asset (N, 3) in its asset's, normal (N, 3)
    in the part's.

    footprint (N,): metres that a sample covers across the ray; along the surface it is stretched by 1 / cosine (N,).
    """

    part: FloatArray
    asset: FloatArray
    normal: FloatArray
    footprint: FloatArray
    cosine: FloatArray

    @property
    def spread(self) -> FloatArray:
        """One number for both ways of the footprint (N,): their geometric mean."""
        return np.asarray(self.footprint / np.sqrt(np.maximum(self.cosine, 0.02)))


@dataclass(frozen=True)
class SurfaceMaterial:
    """albedo (N, 3) linear; gloss, glass, reflectivity (N,) in 0..1."""

    albedo: FloatArray
    gloss: FloatArray
    glass: FloatArray
    reflectivity: FloatArray


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
    """What a path tracer is told beside a surface's colour; where a surface is glass (`SurfaceMaterial.glass`) it
    mirrors as glass does.

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
