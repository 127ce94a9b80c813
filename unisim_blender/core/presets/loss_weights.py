"""Weights of a training's loss terms."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class LossWeights:
    """Each preset states those of its terms; a term of weight 0 is not part of its loss."""

    rgb: float = 0.0
    chroma: float = 0.0
    """How much more what is not grey of a difference of colours counts, see `losses.colour_squares`."""
    perceptual: float = 0.0
    lidar_depth: float = 0.0
    lidar_reach: float = 0.0
    lidar_opacity: float = 0.0
    lidar_free: float = 0.0
    lidar_intensity: float = 0.0
    lidar_drop: float = 0.0
    sdf_band: float = 0.0
    eikonal: float = 0.0
    normal_smoothness: float = 0.0
    distortion: float = 0.0
    unobserved: float = 0.0
    adversarial: float = 0.0
    latent: float = 0.0
