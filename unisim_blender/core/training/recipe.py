"""What a training does: its preset, less what is left out, with the density that was chosen."""

from __future__ import annotations

from dataclasses import replace

from ..errors import SceneError
from ..presets import preset
from ..presets.preset import Preset
from .ablations import ABLATIONS
from .config import TrainConfig


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
