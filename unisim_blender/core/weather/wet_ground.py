"""Wet ground: water in its pores makes it darker for light that is scattered back below the surface (Lekner & Dorf 1988), and
glossier: the water's surface reflects what stands above it (Fresnel). The same film takes light away from beams."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb, srgb_from_linear
from ..geometry import BoolArray, FloatArray
from ..sensors.frames import CameraFrame
from .camera import LUMINANCE, Air, interpolated

Floats = NDArray[np.floating[Any]]
WATER_INDEX = 1.33
DIFFUSE_REFLECTANCE = 0.066
"""Reflectance of a surface of water for light from all of the sky."""
INTERNAL_REFLECTANCE = 1 - (1 - DIFFUSE_REFLECTANCE) / WATER_INDEX**2
"""Reflectance of that surface for scattered light from below."""
GROUND_M = 0.15
"""Height above the ground, metres, up to which surfaces are wet."""
SLOPE_RAD = 0.02
"""Standard deviation of the water's slope along the line of sight, which draws reflections out vertically."""
BRIGHTEST_ALBEDO = 0.9


def fresnel(cosine: Floats) -> FloatArray:
    """Return the reflectance (...) of water for unpolarised light whose angle to the vertical has this cosine (...)."""
    cosine = np.clip(cosine.astype(np.float64), 0.0, 1.0)
    inside = np.sqrt(1 - (1 - cosine**2) / WATER_INDEX**2)
    across = (cosine - WATER_INDEX * inside) / (cosine + WATER_INDEX * inside)
    along = (WATER_INDEX * cosine - inside) / (WATER_INDEX * cosine + inside)
    return np.asarray((across**2 + along**2) / 2)


def seen_through(albedo: Floats, cosine: Floats) -> FloatArray:
    """Return the radiance (...) of wet ground under the sky's light relative to dry ground of an albedo (...), without what
    the water's surface reflects: (1 - R) (1 - F) / n² / (1 - p albedo), p the surface's reflectance from below."""
    through = (1 - DIFFUSE_REFLECTANCE) * (1 - fresnel(cosine)) / WATER_INDEX**2
    return np.asarray(through / (1 - INTERNAL_REFLECTANCE * albedo))


def beam_gain(intensity: Floats, cosine: Floats, wet: float) -> FloatArray:
    """Return the power (...) of wet ground's returns relative to that of dry ground of an intensity (...). Light goes
    through the film's surface twice, at the beam's angle: (1 - F)² / n² / (1 - p intensity); what is reflected is lost."""
    film = (1 - fresnel(cosine)) ** 2 / WATER_INDEX**2 / (1 - INTERNAL_REFLECTANCE * np.clip(intensity, 0, 1))
    return np.asarray(1 - wet + wet * film)


class Mirror(NamedTuple):
    """What the ground of a coarse image (h, w) reflects: ``ground``, 1 where it is ground and 0 elsewhere, and there
    ``depth_m`` (h, w), ``cosine`` (h, w) of the angle to the vertical, and ``light`` (h, w, 3), linear; 0 elsewhere."""

    ground: NDArray[np.float32]
    depth_m: NDArray[np.float32]
    cosine: NDArray[np.float32]
    light: NDArray[np.float32]

    def drawn_out(self, pixels_per_rad: float) -> Mirror:
        """Return the mirror with its light drawn out vertically by the water's slopes, which tilt it twice."""
        sigma = 2 * SLOPE_RAD * pixels_per_rad
        reach = min(int(np.ceil(2 * sigma)), len(self.ground) - 1)
        total, weights = np.zeros_like(self.light), np.zeros_like(self.ground)
        for step in range(-reach, reach + 1):
            share = np.float32(np.exp(-((step / max(sigma, 1e-6)) ** 2) / 2))
            here, there = (
                slice(max(step, 0), len(weights) + min(step, 0)),
                slice(max(-step, 0), len(weights) - max(step, 0)),
            )
            total[here] += share * self.light[there]
            weights[here] += share * self.ground[there]
        light = total / np.maximum(weights, 1e-6)[..., None] * self.ground[..., None]
        return self._replace(light=light.astype(np.float32))

    def wetted(
        self, frame: CameraFrame, wet: float, air: Air, rows: slice, columns: slice, size: tuple[int, int]
    ) -> NDArray[np.float32]:
        """Return the colours (H, W, 3), sRGB, of a frame with depths whose ground is wet for a part ``wet`` of its area. The
        frame is of these rows and columns of an image of ``size``, height and width."""
        assert frame.depth_m is not None
        image = frame.rgb.copy()
        with_ground = np.flatnonzero(self.ground.any(1))
        if not len(with_ground):
            return image
        numbers = np.arange(size[0])[rows]
        above = int(np.searchsorted(numbers, (with_ground[0] - 1) * size[0] / len(self.ground)))
        rows = slice(int(numbers[0]) + above * (rows.step or 1), rows.stop, rows.step)
        depths, shown = frame.depth_m[above:], frame.rgb[above:]
        stack = np.concatenate([np.stack(self[:3], -1), self.light], -1)
        values = interpolated(stack, rows, columns, size)
        share = values[..., 0]
        depth_m = values[..., 1] / np.maximum(share, 1e-6)
        apart = np.abs(np.where(np.isfinite(depths), depths, 0) - depth_m)
        y, x = np.nonzero((share > 0.1) & (apart < 0.1 + 0.05 * depth_m))
        values = values[y, x, 2:] / share[y, x, None]
        colours = linear_from_srgb(shown[y, x])
        albedo = np.clip(colours @ LUMINANCE / float(air.light @ LUMINANCE), 0, BRIGHTEST_ALBEDO)
        darker = 1 - wet + wet * seen_through(albedo, values[:, 0])
        reflected = wet * fresnel(values[:, 0])[:, None] * values[:, 1:]
        image[y + above, x] = srgb_from_linear((colours * darker[:, None] + reflected).astype(np.float32))
        return image


def is_ground(height_m: FloatArray, down: FloatArray) -> BoolArray:
    """Return which points (N,) at heights above the ground are ground, seen along rays that go ``down`` (N,) by a part of
    their length."""
    return np.asarray((np.abs(height_m) < GROUND_M) & (down > 0))
