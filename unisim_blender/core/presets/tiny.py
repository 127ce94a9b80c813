"""Preset ``tiny``."""

from ..model.config import GridConfig, ModelConfig, SampleConfig
from .ours import ours
from .preset import register

TINY = register(
    ours(
        "tiny",
        "Tiny",
        "For tests",
        ModelConfig(
            static_grid=GridConfig(3.2, 0.1, 6, 4, 15),
            background_grid=GridConfig(8, 256, 4, 4, 13),
            actor_grid=GridConfig(4, 32, 4, 4, 11),
            samples=SampleConfig(12, 8, 6, 4, 4, 2),
            light="ground",
            hidden=32,
            features=15,
            latent=16,
            hyper_hidden=16,
            decoder_channels=16,
            decoder_blocks=1,
        ),
    )
)
