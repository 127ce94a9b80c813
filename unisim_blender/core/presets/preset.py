"""What a preset states: the method, the model's shapes, the loss, and what the training does. Nothing
of it is inferred."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..model.config import ModelConfig
from ..registry import Registry
from .loss_weights import LossWeights

Ablation = Literal["decoder", "actor-prior", "tracklet-refinement", "lidar"]
"""Parts that a training can leave out, see `training/config.py`."""
SignedDistance = Literal["logistic", "unisim"]


@dataclass(frozen=True)
class Preset:
    """How a scene is trained, by the name that `unisim train --preset` has for it."""

    name: str
    title: str
    about: str
    """One line for people, without a full stop."""
    method: str
    """Whose method it is: "neural" is ours. `scene.json` keeps it, and it is the name of the scene's renderer."""
    model: ModelConfig
    weights: LossWeights
    mirrored: float
    """Chance that a step sees a vehicle mirrored. What was never recorded learns from the other side all the same; with
    a half, a lit side and a shaded one would blend."""
    refines_tracklets: bool
    refines_cameras: bool
    ablations: tuple[Ablation, ...]
    """What can be left out (`unisim train --without`)."""
    densities: tuple[SignedDistance, ...]
    """Densities that can be chosen in place of the model's own (`--density`)."""
    can_be_adversarial: bool
    is_baseline: bool
    """Whether it is there to be compared with, and not offered in Blender."""
    uses_lidar: bool = True


PRESETS: Registry[Preset] = Registry("a preset")
"""The registered presets by the name that `unisim train --preset` has for them."""
register = PRESETS.register
