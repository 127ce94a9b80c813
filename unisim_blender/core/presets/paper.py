"""Preset ``paper``."""

from ..model.config import GridConfig, ModelConfig, SampleConfig
from .ours import ours
from .preset import register

PAPER = register(
    ours(
        "paper",
        "Paper",
        "The sizes of the paper's re-implementation, for a GPU",
        ModelConfig(
            static_grid=GridConfig(7.5, 0.03, 16, 2, 21),
            background_grid=GridConfig(16, 4096, 16, 2, 19),
            actor_grid=GridConfig(16, 256, 8, 2, 14),
            samples=SampleConfig(48, 32, 24, 24, 24, 16),
            hidden=32,
            features=32,
            head="sample",
            density="unisim",
            decoder_kernel=7,
            upsample=3,
        ),
    )
)
