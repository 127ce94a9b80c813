"""Preset ``compact``."""

from ..model.config import GridConfig, ModelConfig, SampleConfig
from .ours import ours
from .preset import register

COMPACT = register(
    ours(
        "compact",
        "Compact",
        "For scenes of a few megabytes",
        ModelConfig(
            static_grid=GridConfig(3.2, 0.05, 8, 4, 17),
            background_grid=GridConfig(8, 1024, 6, 4, 15),
            actor_grid=GridConfig(4, 48, 5, 4, 12),
            samples=SampleConfig(32, 12, 10, 8, 16, 6),
            light="ground",
            decoder_blocks=1,
            decoder_kernel=1,
            upsample=1,
        ),
    )
)
