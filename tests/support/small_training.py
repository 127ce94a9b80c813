"""A training of six steps, and a signal in the middle of one."""

from __future__ import annotations

import os

import pytest

from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.trainer import Trainer

SMALL = TrainConfig(
    cameras=("front_camera",), lidars=("pandar64",), frames=(0, 1, 2, 3), preset="tiny", iterations=6, patches=2,
    patch_cells=8,
    lidar_rays=64, perceptual_from=0.2, poses_from=0.4,
)  # fmt: skip


def stop_after(steps: int, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Send this process a signal in the middle of a step."""
    step = Trainer.step

    def stopped(trainer: Trainer) -> dict[str, float]:
        if trainer.iteration + 1 == steps:
            os.kill(os.getpid(), number)
        return step(trainer)

    monkeypatch.setattr(Trainer, "step", stopped)
