"""Actors lit like the ground under them: a car turns dark in the shade, also where an edit puts it.

A small network maps the static field's features of the ground around the place where a ray hits an actor to a scale
and a shift of the actor's features. It sees features alone and no coordinates, so it learns how the ground's appearance
goes along with the light, and not where the shade is.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..ops.constants import LIGHT_REACH_M
from .config import ModelConfig
from .networks import mlp, run_mlp
from .shapes import perceptrons


class Light(nn.Module):
    """Features of the ground (N, F) to scales and shifts of an actor's features.

    ``home`` (actors, 3), volume coordinates, is where each actor was recorded. Features of two scenes do not compare,
    so a foreign actor keeps the light of that place.
    """

    def __init__(self, config: ModelConfig, actors: int) -> None:
        super().__init__()
        self.network = mlp(*perceptrons(config)["light.network"])
        last = self.network[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.register_buffer("home", torch.zeros(actors, 3))
        self.register_buffer(
            "around", LIGHT_REACH_M * torch.tensor([[1.0, 0], [-1, 0], [0, 1], [0, -1]]), persistent=False
        )

    home: Tensor
    around: Tensor

    def forward(self, feature: Tensor, appearance: Tensor) -> Tensor:
        """Features (P, K, F) of actors over ground that looks like this (P, F)."""
        scale, shift = run_mlp(self.network, appearance)[:, None].chunk(2, -1)
        lit: Tensor = feature * (1 + scale) + shift
        return lit
