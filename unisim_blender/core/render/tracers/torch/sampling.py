"""How many samples rays take, and which parts of the scene they see."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Sampling:
    """``jitter`` draws samples at random in their strata; ``fine`` multiplies their number in the volume,
    ``background_fine`` beyond it; ``background`` queries the background model, ``sky`` what lies behind that and the
    light it gives: a camera sees them, a LiDAR does not."""

    jitter: bool = False
    fine: float = 1.0
    background_fine: float = 1.0
    background: bool = True
    sky: bool = True
    mirror: Tensor | None = None
    """(appearances,) chance that an appearance is mirrored, in training: on all the rays that are traced together."""
    generator: torch.Generator | None = None

    def count(self, samples: int) -> int:
        """How many samples there are in the volume for so many of the configuration."""
        return max(2, round(samples * self.fine))

    def background_count(self, samples: int) -> int:
        """How many samples there are beyond the volume for so many of the configuration."""
        return max(2, round(samples * self.background_fine))
