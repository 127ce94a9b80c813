"""Preset ``small``."""

from ..model.config import GridConfig, ModelConfig, SampleConfig
from .ours import ours
from .preset import register

SMALL = register(
    ours(
        "small",
        "Small",
        "For training on two processor cores",
        ModelConfig(
            static_grid=GridConfig(3.2, 0.05, 8, 4, 19),
            background_grid=GridConfig(8, 2048, 8, 4, 17),
            actor_grid=GridConfig(4, 64, 6, 4, 13),
            samples=SampleConfig(32, 12, 10, 8, 16, 6),
            light="ground",
            decoder_blocks=1,
            decoder_kernel=1,
            upsample=1,
        ),
    )
)
