"""What a training does by its preset: the model's shapes, the loss's terms, and what it is to go without.

The rivals do what their papers say, with the same rays, samples and optimisers: squared errors of colours, depths at LiDAR
returns, and nothing of what shapes a signed distance, refines poses or continues what nobody saw.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..errors import SceneError
from ..model.config import ModelConfig, preset
from .config import LossWeights, TrainConfig

PARTS = ("decoder", "actor-prior", "tracklet-refinement", "lidar")
"""What a training can be asked to do without."""

_OURS = {"chroma", "perceptual", "lidar_opacity", "lidar_free", "band", "eikonal", "flat", "spread", "hidden"}
"""Terms that a rival's loss lacks."""


@dataclass(frozen=True)
class Recipe:
    """``model``, the terms' ``weights``, the chance that a vehicle is ``mirrored``, and whether tracklets and cameras are refined
    and LiDAR teaches."""

    model: ModelConfig
    weights: LossWeights
    mirrored: float
    refines_tracklets: bool
    refines_cameras: bool
    uses_lidar: bool


def recipe(config: TrainConfig) -> Recipe:
    """The recipe of a training. SceneError names what does not go together."""
    model, out = preset(config.preset), config.without
    rival = model.method != "neural"
    for part in out:
        if part not in PARTS:
            raise SceneError(f"there is no part {part!r} to do without: there are {', '.join(PARTS)}")
        if rival and part != "lidar":
            raise SceneError(f"preset {config.preset!r} cannot do without {part!r}, for it has none")
    if not rival and "lidar" in out:
        raise SceneError(f"preset {config.preset!r} cannot do without 'lidar': it learns signed distances from its returns")
    if rival and (config.density or config.adversarial):
        what = f"a density {config.density!r}" if config.density else "an adversarial loss"
        raise SceneError(f"preset {config.preset!r} does not take {what}: it is another method's")
    if config.density is not None:
        model = replace(model, density=config.density)
    if "decoder" in out:
        model = replace(model, colour="sample", decoder_kernel=1, upsample=1)
    if "actor-prior" in out:
        model = replace(model, actors="tables")
    uses_lidar = "lidar" not in out
    absent = {name for name in vars(config.weights) if name in _OURS or (name.startswith("lidar") and not uses_lidar)}
    return Recipe(
        model=model,
        weights=replace(config.weights, **dict.fromkeys(absent, 0.0)) if rival else config.weights,
        # the prior is what actors share, and that their sides are alike
        mirrored=0.0 if rival or "actor-prior" in out else config.mirrored,
        refines_tracklets=not rival and "tracklet-refinement" not in out,
        refines_cameras=not rival,
        uses_lidar=uses_lidar,
    )
