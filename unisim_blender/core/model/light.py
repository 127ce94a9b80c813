"""An actor is lit as the ground under it is: a car that drives into the shade turns dark there, also where an edit takes it.

A scale and a shift of its features, from the static field's look of the ground round the place where a ray meets it. What is
learnt is how much darker things look over ground that looks like this, not what is where: the network is small and sees looks
alone.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ..ops.constants import LIGHT_REACH_M
from .config import ModelConfig
from .networks import mlp, run_mlp
from .shapes import perceptrons


class Light(nn.Module):
    """Looks of the ground (N, F) to scales and shifts of an actor's features.

    ``home`` (actors, 3), volume coordinates, is where each actor was recorded: a foreign actor in another scene, whose looks mean
    something else, brings the light from there.
    """

    def __init__(self, config: ModelConfig, actors: int) -> None:
        super().__init__()
        self.network = mlp(*perceptrons(config)["light.network"])
        last = self.network[-1]
        assert isinstance(last, nn.Linear)
        nn.init.zeros_(last.weight)
        nn.init.zeros_(last.bias)
        self.register_buffer("home", torch.zeros(actors, 3))
        self.register_buffer("around", LIGHT_REACH_M * torch.tensor([[1.0, 0], [-1, 0], [0, 1], [0, -1]]), persistent=False)

    home: Tensor
    around: Tensor

    def forward(self, feature: Tensor, appearance: Tensor) -> Tensor:
        """Features (P, K, F) of actors over ground that looks like this (P, F)."""
        scale, shift = run_mlp(self.network, appearance)[:, None].chunk(2, -1)
        lit: Tensor = feature * (1 + scale) + shift
        return lit
