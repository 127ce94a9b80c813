"""The ground that nobody saw, filled with what was seen of the same street.

The ground around a drive is a map of texels, whose rows go along the drive. A texel that some recorded image shows has the
colour that the trained scene gives it there; one that some sweep shows has its intensity. The others are filled from those
of their own rows, ahead and behind, and where these have none from those beside: lanes, kerbs and markings go on along a
street. The map is a property of the scene: all frames, cameras and LiDARs show the same.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry import BoolArray, FloatArray, bilinear, box_sums, transform_points
from .tracer import Array

FILL_VERSION = 1
"""Version of the cached maps: to be raised when the same scene gives another map."""
TEXEL_M, MAX_TEXELS = 0.1, 2**22
"""Edge of a texel, metres, of which longer drives have larger ones; and the largest number of them."""
REACH_M = 45.0
"""Distance from a sensor, metres, up to which it shows texels."""
FILLED_M = 4.0
"""Distance from what was seen, metres, up to which the ground is filled."""
UNSURE_TEXELS, FEATHER_TEXELS = 2, 3
"""Texels beside those that were seen that are not filled, and over how many the filling grows from there."""
ON_SURFACE_M, PROBE_M = 0.3, 1.0
"""Largest distance of the scene's surface from a texel that it shows, and of the beginning of a ray to it, metres."""
COLOUR_PART = 0.8
"""Largest part of a colour that is replaced: the mean of two guesses is better than either."""
ALONG = 5
"""How often the map is halved along the drive, before it is halved in both directions."""


@dataclass(frozen=True)
class GroundFill:
    """Maps of the ground, (X, Y) texels of edge ``texel_m``, the first at the origin of the grid: ``colours`` (X, Y, 3) as the
    decoder gives them, and ``intensity`` (X, Y, 1). ``colour_share`` and ``intensity_share`` (X, Y, 1), 0 to 1: how much of
    each replaces what the scene has there."""

    grid_from_world: FloatArray
    texel_m: float
    colours: Array
    colour_share: Array
    intensity: Array
    intensity_share: Array

    def of_image(self, points: FloatArray, ground: BoolArray) -> tuple[Array, Array]:
        """Return colours (..., 3) and shares (..., 1) for what pixels show at points (..., 3), world frame, where that is
        ``ground`` (...)."""
        return self._at(self.colours, points), self._at(self.colour_share, points) * ground[..., None]

    def of_beams(self, points: FloatArray, ground: BoolArray) -> tuple[Array, Array]:
        """Return intensities (..., 1) and shares (..., 1) for beams that end at points (..., 3), world frame."""
        return self._at(self.intensity, points), self._at(self.intensity_share, points) * ground[..., None]

    def _at(self, values: Array, points: FloatArray) -> Array:
        """Return values (..., C) at points (..., 3), bilinear between texels; 0 outside of the map."""
        v, u = transform_points(self.grid_from_world, points.reshape(-1, 3))[:, :2].T / self.texel_m
        height, width = values.shape[:2]
        number = np.flatnonzero((v >= 0.5) & (v <= height - 0.5) & (u >= 0.5) & (u <= width - 0.5))
        out = np.zeros((len(u), values.shape[2]), np.float32)
        out[number] = bilinear(values, u[number], v[number])
        return out.reshape(*points.shape[:-1], -1)


def share_of(known: BoolArray, seen: BoolArray, texel_m: float) -> Array:
    """Return how much of the map (X, Y, 1) is filled: texels that were not ``seen`` (X, Y), beside those that are ``known``."""
    wanted = (box_sums(known, round(FILLED_M / texel_m)) > 0) & (box_sums(seen, UNSURE_TEXELS) == 0)
    grown = box_sums(wanted, FEATHER_TEXELS // 2) / FEATHER_TEXELS**2
    return np.where(seen, 0, grown)[..., None].astype(np.float32)


def filled(values: Array, known: BoolArray, along: int = ALONG) -> Array:
    """Return values (X, Y, C) in which those that are not ``known`` (X, Y) are interpolated from coarser ones: means of pairs
    along the first axis, ``along`` times, then of fours (Gortler et al., "The Lumigraph", SIGGRAPH 1996, section 3.4)."""
    if known.all() or not known.any():
        return np.where(known[..., None], values, np.float32(0))
    axes = [axis for axis in ((0,) if along > 0 and len(known) > 1 else (0, 1)) if known.shape[axis] > 1]
    weights = known.astype(np.float32)[..., None]
    total, pad = values * weights, [(0, known.shape[axis] % 2 if axis in axes else 0) for axis in (0, 1)]
    for axis in axes:
        total, weights = (_paired(np.pad(x, (*pad, (0, 0))) if axis == axes[0] else x, axis) for x in (total, weights))
    coarse = filled(total / np.maximum(weights, 1), weights[..., 0] > 0, along - 1)
    for axis in axes:
        coarse = _doubled(coarse, axis, known.shape[axis])
    return np.where(known[..., None], values, coarse)


def _paired(values: Array, axis: int) -> Array:
    """Return the sums of pairs along an axis of even length."""
    return np.asarray(
        values.take(range(0, values.shape[axis], 2), axis) + values.take(range(1, values.shape[axis], 2), axis)
    )


def _doubled(values: Array, axis: int, count: int) -> Array:
    """Return values with ``count`` places along an axis in place of half as many, linear between these."""
    place = np.clip((np.arange(count) + 0.5) / 2 - 0.5, 0, values.shape[axis] - 1).astype(np.float32)
    low = place.astype(np.int64)
    high = np.minimum(low + 1, values.shape[axis] - 1)
    part = (place - low).reshape([-1 if each == axis else 1 for each in range(values.ndim)])
    return np.asarray((1 - part) * values.take(low, axis) + part * values.take(high, axis))
