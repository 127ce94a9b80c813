"""How many rays a step has: by device, or as told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from click.testing import CliRunner
from small_training import SMALL, small_log

from unisim_blender.core.cli.commands.train import command
from unisim_blender.core.data.log import Log
from unisim_blender.core.errors import SceneError
from unisim_blender.core.presets import PRESETS, preset
from unisim_blender.core.training.config import GPU_RAYS, RAYS, TrainConfig, rate_factor, ray_counts, steps_of
from unisim_blender.core.training.trainer import Trainer


def test_a_cpu_has_the_defaults_and_a_gpu_more() -> None:
    config = TrainConfig(("a",), (), (0,))
    assert ray_counts("cpu") == (config.patches, config.lidar_rays) == (16, RAYS // 4)
    assert ray_counts("cuda:1") == (GPU_RAYS // 256, GPU_RAYS // 4)


def test_rays_that_are_told_count_and_are_never_none() -> None:
    assert ray_counts("cuda", 512) == (2, 128)
    assert ray_counts("cpu", 1) == (2, 1)


@pytest.mark.parametrize("rays", (16384, 65536))
def test_rates_and_steps_follow_from_the_rays_of_a_preset_for_gpus(rays: int) -> None:
    own, small = preset("hd-gpu"), preset("small")
    patches, _ = ray_counts("cuda", rays)
    assert steps_of(own, patches) == -(-(own.all_rays or 0) // rays) and steps_of(small, patches) is None
    assert rate_factor(own, RAYS) == 1 and rate_factor(own, rays) == 2 and rate_factor(small, rays) == 1
    assert rate_factor(own, 2 * RAYS) == pytest.approx(2**0.5)


def test_a_training_takes_its_presets_rate_and_steps(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tiny = replace(preset("tiny"), rays=8192, all_rays=20_000)
    monkeypatch.setitem(PRESETS, "tiny", tiny)
    asked: list[TrainConfig] = []

    def asks(log: Log, config: TrainConfig, *_: object, **__: object) -> None:
        asked.append(config)
        raise SceneError("that is enough")

    monkeypatch.setattr("unisim_blender.core.training.loop.train", asks)
    log = small_log(tmp_path / "log")
    done = CliRunner().invoke(command, [str(log.path), "--out", str(tmp_path / "scene"), "--preset", "tiny"])
    assert "that is enough" in str(done.exception) and [(c.patches, c.iterations) for c in asked] == [(32, 3)]
    config = replace(SMALL, patches=32, patch_cells=16)
    faster, usual = (
        Trainer(
            log,
            config,
        )
        for _ in range(2)
    )
    usual.rate_factor = 1.0
    for trainer in (faster, usual):
        trainer._set_rates(0.5)
    rates = [[float(group["lr"]) for group in trainer.optimiser.param_groups] for trainer in (faster, usual)]
    assert rates[0] == pytest.approx([2**0.5 * rate for rate in rates[1]])
