"""What a training does: its preset, less its ablations, with the density that was chosen."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..errors import SceneError
from ..presets import Ablation, Preset, preset
from .config import TrainConfig


def without_decoder(preset: Preset) -> Preset:
    """Return the preset in which every sample has its own colour, and no decoder makes pixels of features."""
    return replace(preset, model=replace(preset.model, colour="sample", decoder_kernel=1, upsample=1))


def without_actor_prior(preset: Preset) -> Preset:
    """Return the preset without what actors share: the hypernetwork, and that their sides are alike."""
    return replace(preset, model=replace(preset.model, actors="tables"), mirrored=0.0)


def without_tracklet_refinement(preset: Preset) -> Preset:
    """Return the preset in which boxes stay where the log has them."""
    return replace(preset, refines_tracklets=False)


def without_lidar(preset: Preset) -> Preset:
    """Return the preset that reads no sweep."""
    absent = dict.fromkeys((name for name in vars(preset.weights) if name.startswith("lidar_")), 0.0)
    return replace(preset, weights=replace(preset.weights, **absent), uses_lidar=False)


ABLATIONS: dict[Ablation, Callable[[Preset], Preset]] = {
    "decoder": without_decoder,
    "actor-prior": without_actor_prior,
    "tracklet-refinement": without_tracklet_refinement,
    "lidar": without_lidar,
}
"""By the name that `unisim train --without` has for them."""


def recipe(config: TrainConfig) -> Preset:
    """Return the preset as a training's options change it. Raises `SceneError` naming what does not go together."""
    found = preset(config.preset)
    for name in config.without:
        if name not in ABLATIONS:
            raise SceneError(f"there is no ablation {name!r}: there are {', '.join(ABLATIONS)}")
        if name not in found.ablations:
            raise SceneError(
                f"preset {config.preset!r} cannot do without {name!r}, only without {', '.join(found.ablations)}"
            )
    if config.density is not None:
        if config.density not in found.densities:
            raise SceneError(
                f"preset {config.preset!r} does not take a density {config.density!r}: it is another method's"
            )
        found = replace(found, model=replace(found.model, density=config.density))
    if config.adversarial and not found.can_be_adversarial:
        raise SceneError(f"preset {config.preset!r} does not take an adversarial loss: it is another method's")
    for name, ablated in ABLATIONS.items():
        if name in config.without:
            found = ablated(found)
    return found
