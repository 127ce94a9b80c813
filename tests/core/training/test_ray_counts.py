"""How many rays a step has: by device, or as told."""

from __future__ import annotations

from unisim_blender.core.training.config import GPU_RAYS, RAYS, TrainConfig, ray_counts


def test_a_cpu_has_the_defaults_and_a_gpu_more() -> None:
    config = TrainConfig(("a",), (), (0,))
    assert ray_counts("cpu") == (config.patches, config.lidar_rays) == (16, RAYS // 4)
    assert ray_counts("cuda:1") == (GPU_RAYS // 256, GPU_RAYS // 4)


def test_rays_that_are_told_count_and_are_never_none() -> None:
    assert ray_counts("cuda", 512) == (2, 128)
    assert ray_counts("cpu", 1) == (2, 1)
