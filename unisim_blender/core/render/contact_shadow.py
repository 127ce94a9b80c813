"""Contact shadows under actors that the recording does not have there: without one a car seems to float.

Direct sunlight is in the recorded light; a contact shadow is the sky's light that a body near the ground blocks.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ..colour import linear_from_srgb, srgb_from_linear
from ..geometry import BoolArray, FloatArray, invert_pose, transform_points
from ..world.drive import Actor

MAX_DARKENING = 0.6
"""Fraction of light that is blocked right under an actor."""
SHADOW_DECAY_M = 0.35
"""Distance, in metres, beside an actor's footprint or below its underside over which its shadow falls by a factor e."""
FOOTPRINT_SCALE = 0.92
"""Length and width of a footprint relative to the box: bodies are rounder than their boxes."""
SHADOW_CUTOFF_M = 5 * SHADOW_DECAY_M


def shaded(
    rgb: NDArray[np.float32], points: FloatArray, ground: BoolArray, actors: Iterable[Actor], time_s: float
) -> NDArray[np.float32]:
    """Return the image (H, W, 3), display-referred sRGB, with contact shadows of ``actors`` at ``time_s``.

    ``points`` (H, W, 3) are the places that the pixels show, world frame, metres; ``ground`` (H, W) is True where they
    show no actor.
    """
    assert points.shape == rgb.shape and ground.shape == rgb.shape[:2], (rgb.shape, points.shape, ground.shape)
    light = np.ones(rgb.shape[:2])
    flat = points.reshape(-1, 3)
    for actor in actors:
        if not actor.present(time_s):
            continue
        pose = actor.world_from_actor.at(time_s)
        half = np.asarray(actor.size_m) / 2
        near = np.abs(flat - pose[:3, 3]).max(1) < half.max() + SHADOW_CUTOFF_M
        if not near.any():
            continue
        x, y, z = transform_points(invert_pose(pose), flat[near]).T
        beside = np.hypot(
            np.maximum(np.abs(x) - FOOTPRINT_SCALE * half[0], 0), np.maximum(np.abs(y) - FOOTPRINT_SCALE * half[1], 0)
        )
        height = np.abs(z + half[2])
        blocked = MAX_DARKENING * np.exp(-(beside + height) / SHADOW_DECAY_M)
        light.reshape(-1)[near] *= 1 - blocked
    light = np.where(ground, light, 1.0)
    if light.min() == 1.0:
        return rgb
    dark = srgb_from_linear(linear_from_srgb(np.clip(rgb, 0, 1)) * light[..., None].astype(np.float32))
    return np.where((light < 1.0)[..., None], dark, rgb)
