"""A training of six steps, one with every term from the first step on, and a signal in the middle of a step."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import pytest
from small_log import write_small_log

from unisim_blender.core.data.log import Log
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.trainer import Trainer

SMALL = TrainConfig(
    cameras=("front_camera",), lidars=("pandar64",), frames=(0, 1, 2, 3), preset="tiny", iterations=6, patches=2,
    patch_cells=8,
    lidar_rays=64, perceptual_from=0.2, poses_from=0.4,
)  # fmt: skip
EVERYTHING = replace(
    SMALL, iterations=100, perceptual_from=0.0, poses_from=0.0, unobserved_from=0.0, settled_from=0.0, prune_from=0
)


def small_log(folder: Path) -> Log:
    """Write a log of four frames to a folder that is not there yet, and open it."""
    write_small_log(folder)
    return open_log(folder)


def stop_after(steps: int, number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Send this process a signal in the middle of a step."""
    step = Trainer.step

    def stopped(trainer: Trainer) -> dict[str, float]:
        if trainer.iteration + 1 == steps:
            os.kill(os.getpid(), number)
        return step(trainer)

    monkeypatch.setattr(Trainer, "step", stopped)
