"""What our own presets have in common: all but the model's shapes."""

from __future__ import annotations

from ..model.config import ModelConfig
from .loss_weights import LossWeights
from .preset import Preset

WEIGHTS = LossWeights(
    rgb=3.0,
    chroma=7.0,
    perceptual=0.01,
    lidar_depth=0.05,
    lidar_reach=0.02,
    lidar_opacity=0.01,
    lidar_free=0.05,
    lidar_intensity=0.1,
    lidar_drop=0.02,
    sdf_band=0.1,
    eikonal=0.0015,
    normal_smoothness=0.0012,
    distortion=0.0003,
    unobserved=0.02,
    adversarial=0.001,
    latent=1e-5,
)


def ours(name: str, title: str, about: str, model: ModelConfig) -> Preset:
    """Return a preset of our method with these shapes."""
    return Preset(
        name=name,
        title=title,
        about=about,
        method="neural",
        model=model,
        weights=WEIGHTS,
        mirrored=0.1,
        refines_tracklets=True,
        refines_cameras=True,
        ablations=("decoder", "actor-prior", "tracklet-refinement"),
        densities=("logistic", "unisim"),
        can_be_adversarial=True,
        is_baseline=False,
    )
