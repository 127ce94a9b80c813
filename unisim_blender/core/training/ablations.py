"""What a training can leave out of its preset, one function an ablation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from ..presets.preset import Ablation, Preset


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
