"""The light: a sun, a sky with soft clouds, and how a camera turns light into sRGB."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray

from .materials import noises

SUN = np.array([-0.52, -0.50, 0.98]) / np.linalg.norm([-0.52, -0.50, 0.98])
"""Unit direction (3,) to the sun."""
SUN_SPREAD_RAD = 0.012
"""Half the angle over which a pixel's samples spread on the sun: wider than the true 0.0047, for
penumbrae one can see."""

_SUN_COLOR = np.array([3.0, 2.72, 2.30])
_ZENITH = np.array([0.16, 0.33, 0.72])
_HORIZON = np.array([0.72, 0.82, 0.95])
_GROUND_BOUNCE = np.array([0.26, 0.23, 0.20])
_SKY_LIGHT = np.array([0.50, 0.62, 0.80])
_EXPOSURE = 1.05


def sky(directions: FloatArray) -> FloatArray:
    """Linear radiance (N, 3) of the sky in unit directions (N, 3); below the horizon that of distant ground."""
    up = directions[:, 2]
    rise = np.clip(up, 0.0, 1.0)
    base = _ZENITH + (_HORIZON - _ZENITH) * (np.exp(-rise / 0.22))[:, None]
    base = base + (np.array([1.02, 1.0, 0.98]) - base) * (0.75 * clouds(directions))[:, None]
    toward = np.clip(directions @ SUN, 0.0, 1.0)
    base = base + _SUN_COLOR * (0.05 * toward**8 + 0.12 * toward**64)[:, None]
    below = np.clip(-up / 0.05, 0.0, 1.0)
    return np.asarray(base + (_GROUND_BOUNCE - base) * below[:, None])


def clouds(directions: FloatArray) -> FloatArray:
    """How much of the sky is cloud (N,), 0..1, in unit directions (N, 3): a level high up, none of
    it at the horizon."""
    rise = np.clip(directions[:, 2], 0.0, 1.0)
    plane = directions[:, :2] / (rise + 0.22)[:, None]
    cloud = noises()["cloud"](plane[:, 0] * 2.6 + 3.0, plane[:, 1] * 2.6 + 1.0, np.full(len(rise), 0.02))
    return np.asarray(np.clip(cloud * 0.55 + 0.12, 0.0, 1.0) ** 1.2 * np.clip(rise / 0.12, 0.0, 1.0))


def shade(
    albedo: FloatArray,
    gloss: FloatArray,
    normals: FloatArray,
    directions: FloatArray,
    sunlit: FloatArray,
    ambient: FloatArray,
) -> FloatArray:
    """Linear radiance (N, 3) that leaves surfaces against ``directions`` (N, 3): Lambert, with a little Fresnel gloss.

    sunlit (N,) is the sun's visibility, ambient (N,) how open the surroundings are, both in 0..1. Gloss mirrors a sky
    without clouds, which varies slowly; nothing mirrors the street.
    """
    toward_sun = np.clip(normals @ SUN, 0.0, 1.0)
    upward = (0.5 + 0.5 * normals[:, 2])[:, None]
    fill = (_GROUND_BOUNCE * (1 - upward) + _SKY_LIGHT * upward) * ambient[:, None]
    light = _SUN_COLOR * (toward_sun * sunlit)[:, None] + fill
    out = albedo * light
    cosine = np.clip(-(directions * normals).sum(-1), 0.0, 1.0)
    fresnel = gloss * (1.0 + 6.0 * (1.0 - cosine) ** 3)
    mirror_up = directions[:, 2] + 2 * cosine * normals[:, 2]
    tint = _GROUND_BOUNCE + (_HORIZON * 0.9 - _GROUND_BOUNCE) * np.clip(0.5 + 2.0 * mirror_up, 0.0, 1.0)[:, None]
    return np.asarray(out + tint * (fresnel * ambient)[:, None])


def display(radiance: FloatArray) -> NDArray[np.float32]:
    """Display-referred sRGB in 0..1 of linear radiance: a soft shoulder, then sRGB's curve."""
    x = 1.0 - np.exp(-_EXPOSURE * np.maximum(radiance, 0.0))
    encoded = np.where(x <= 0.0031308, 12.92 * x, 1.055 * np.maximum(x, 1e-9) ** (1 / 2.4) - 0.055)
    return np.asarray(encoded, np.float32)


def sun_directions(samples: int) -> FloatArray:
    """Directions (samples ** 2, 3) spread over the sun, one for each sample of a pixel."""
    side = np.cross(SUN, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    up = np.cross(side, SUN)
    offset = (np.arange(samples) + 0.5) / samples * 2 - 1
    a, b = np.meshgrid(offset, offset, indexing="ij")
    spread = a.reshape(-1, 1) * side + b.reshape(-1, 1) * up
    directions = SUN + SUN_SPREAD_RAD * spread
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))
