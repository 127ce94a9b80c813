"""What the baselines have in common. They do what their papers say, with our rays, samples and optimisers: squared
errors of colours, depths at LiDAR returns, and nothing of what shapes a signed distance, refines poses or continues
what nobody saw."""

from __future__ import annotations

from dataclasses import replace

from ..model.config import ModelConfig, SampleConfig
from .loss_weights import LossWeights
from .preset import Preset
from .small import SMALL

SHAPES = replace(
    SMALL.model, samples=SampleConfig(48, 24, 12, 12, 16, 8), light="fixed", colour="sample", density="volume",
    decoder_kernel=1, upsample=1,
)  # fmt: skip
"""Those of ``small``, with a density of its own and a colour at every sample."""
WEIGHTS = LossWeights(rgb=3.0, lidar_depth=0.05, lidar_reach=0.02, lidar_intensity=0.1, lidar_drop=0.02, latent=1e-5)


def baseline(name: str, title: str, about: str, model: ModelConfig) -> Preset:
    """Return a baseline's preset; its method has its name."""
    return Preset(
        name=name,
        title=title,
        about=about,
        method=name,
        model=model,
        weights=WEIGHTS,
        mirrored=0.0,
        refines_tracklets=False,
        refines_cameras=False,
        ablations=("lidar",),
        densities=(),
        can_be_adversarial=False,
        is_baseline=True,
    )
