"""The light: a sun or a moon, a sky with soft clouds, lamps, and how a camera turns light into sRGB."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from unisim_blender.core.geometry import FloatArray

from .materials import noises

SUN = np.array([-0.52, -0.50, 0.98]) / np.linalg.norm([-0.52, -0.50, 0.98])
"""Unit direction (3,) to the sun."""
SUN_SPREAD_RAD = 0.012
"""Half the angle over which a pixel's samples spread on the sun: wider than the true 0.0047, for
penumbrae one can see."""

_EXPOSURE = 1.05
LAMP_COLOUR = np.array([1.0, 0.74, 0.44])
LAMP_LIGHT, LAMP_REACH_M = 45.0, 20.0
"""A lamp's light a metre away, and how far it reaches."""
LAMP_DROP_M, _HEAD_M, _MAX_LAMP_LIGHT = 0.15, 0.4, 40.0
"""How far below its head's middle a lamp shines from; how large its head is, which it lights from below; and its most light."""


@dataclass(frozen=True, eq=False)
class StreetLight:
    """Linear colours (3,): the sun's or the moon's, both at `SUN`; of the sky's zenith, horizon and clouds; light from the ground
    and from the sky. lamps (L, 3): places of lamps, street frame."""

    sun: FloatArray = field(default_factory=lambda: np.array([3.0, 2.72, 2.30]))
    zenith: FloatArray = field(default_factory=lambda: np.array([0.16, 0.33, 0.72]))
    horizon: FloatArray = field(default_factory=lambda: np.array([0.72, 0.82, 0.95]))
    cloud: FloatArray = field(default_factory=lambda: np.array([1.02, 1.0, 0.98]))
    bounce: FloatArray = field(default_factory=lambda: np.array([0.26, 0.23, 0.20]))
    sky: FloatArray = field(default_factory=lambda: np.array([0.50, 0.62, 0.80]))
    lamps: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))


DAY = StreetLight()


def night(lamps: FloatArray) -> StreetLight:
    """Return the light of a night with lamps (L, 3) in a town whose glow lies on the horizon."""
    colours = ([0.020, 0.024, 0.032], [0.004, 0.007, 0.018], [0.040, 0.030, 0.026], [0.030, 0.026, 0.026])
    sun, zenith, horizon, cloud = (np.array(colour) for colour in colours)
    return StreetLight(
        sun, zenith, horizon, cloud, np.array([0.030, 0.024, 0.018]), np.array([0.020, 0.022, 0.030]), lamps
    )


def sky(directions: FloatArray, light: StreetLight = DAY) -> FloatArray:
    """Linear radiance (N, 3) of the sky in unit directions (N, 3); below the horizon that of distant ground."""
    up = directions[:, 2]
    rise = np.clip(up, 0.0, 1.0)
    base = light.zenith + (light.horizon - light.zenith) * (np.exp(-rise / 0.22))[:, None]
    base = base + (light.cloud - base) * (0.75 * clouds(directions))[:, None]
    toward = np.clip(directions @ SUN, 0.0, 1.0)
    base = base + light.sun * (0.05 * toward**8 + 0.12 * toward**64)[:, None]
    below = np.clip(-up / 0.05, 0.0, 1.0)
    return np.asarray(base + (light.bounce - base) * below[:, None])


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
    lamps: FloatArray | float = 0.0,
    light: StreetLight = DAY,
) -> FloatArray:
    """Linear radiance (N, 3) that leaves surfaces against ``directions`` (N, 3): Lambert, with a little Fresnel gloss.

    sunlit (N,) is the sun's visibility, ambient (N,) how open the surroundings are, both in 0..1. Gloss mirrors a sky
    without clouds, which varies slowly; nothing mirrors the street. lamps (N, 3) is the light that lamps shed.
    """
    toward_sun = np.clip(normals @ SUN, 0.0, 1.0)
    upward = (0.5 + 0.5 * normals[:, 2])[:, None]
    fill = (light.bounce * (1 - upward) + light.sky * upward) * ambient[:, None]
    out = albedo * (light.sun * (toward_sun * sunlit)[:, None] + fill + lamps)
    cosine = np.clip(-(directions * normals).sum(-1), 0.0, 1.0)
    fresnel = gloss * (1.0 + 6.0 * (1.0 - cosine) ** 3)
    mirror_up = directions[:, 2] + 2 * cosine * normals[:, 2]
    tint = light.bounce + (light.horizon * 0.9 - light.bounce) * np.clip(0.5 + 2.0 * mirror_up, 0.0, 1.0)[:, None]
    return np.asarray(out + tint * (fresnel * ambient)[:, None])


def lamp_light(lamp: FloatArray, points: FloatArray, normals: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the light (N,) that a lamp (3,) sheds on points (N, 3) with unit normals (N, 3) if nothing stands between, and unit
    directions (N, 3) and distances (N,) to where it shines from. It shines down, and fades to nothing at `LAMP_REACH_M`."""
    away = lamp - [0.0, 0.0, LAMP_DROP_M] - points
    distance = np.linalg.norm(away, axis=1)
    toward = away / np.maximum(distance, 1e-6)[:, None]
    fade = np.clip(1 - (distance / LAMP_REACH_M) ** 4, 0, 1) ** 2
    down = np.where(distance < _HEAD_M, 1.0, np.clip(0.15 + 1.1 * toward[:, 2], 0, 1))
    light = LAMP_LIGHT / np.maximum(distance**2, 1e-6) * fade * down * np.clip((toward * normals).sum(1), 0, 1)
    return np.minimum(light, _MAX_LAMP_LIGHT), toward, distance


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
