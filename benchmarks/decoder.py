"""The compiled decoder beside torch's, from composited features to images: interleaved in one run, medians,
and their ratio.

python benchmarks/decoder.py [--threads N] [--rounds R]
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

from unisim_blender.core import native
from unisim_blender.core.model.config import ModelConfig
from unisim_blender.core.model.decode import CameraDecoder, LidarHead, RayHead
from unisim_blender.core.model.networks import mlp
from unisim_blender.core.model.scene_file import Weights
from unisim_blender.core.model.shapes import SH_WIDTH
from unisim_blender.core.presets import preset
from unisim_blender.core.render.tracers.compiled.decoder import Decoder

CASES: dict[str, tuple[ModelConfig, int, int]] = {
    "three blocks 3x3, 960x540 x 2": (
        dataclasses.replace(preset("small").model, decoder_kernel=3, decoder_blocks=3, upsample=2), 540, 960,
    ),
    "small, 1920x1080": (preset("small").model, 1080, 1920),
    "paper, 640x360 x 3": (preset("paper").model, 360, 640),
}  # fmt: skip


def implementations(config: ModelConfig, h: int, w: int, threads: int) -> list[Callable[[], Any]]:
    """An image of h x w cells compiled, compiled in half precision, and by torch."""
    torch.manual_seed(0)
    head, decoder = RayHead(config, 1), CameraDecoder(config).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    model = nn.ModuleDict({"ray_head": head, "camera_decoder": decoder, "lidar_head": LidarHead(config)})
    model["sample_head"] = mlp(config.features + SH_WIDTH, config.hidden, config.features, layers=3)
    weights = Weights(Path("held"), {name: value.numpy() for name, value in model.state_dict().items()})
    features, directions = torch.randn(h, w, config.features), F.normalize(torch.randn(h, w, 3), dim=-1)

    def plain() -> torch.Tensor:
        camera = torch.zeros(h * w, dtype=torch.long)
        x = head(features.view(h * w, -1), directions.view(h * w, 3), camera)
        out: torch.Tensor = decoder(x.view(1, h, w, -1).permute(0, 3, 1, 2))
        return out

    def compiled(half: bool) -> Callable[[], Any]:
        fast = Decoder(weights, config, 1, half, threads)
        return lambda: fast.image(features.numpy(), directions.numpy(), 0)

    return [compiled(False), compiled(True), plain]


@click.command()
@click.option("--threads", default=2, show_default=True)
@click.option("--rounds", default=5, show_default=True)
@torch.no_grad()
def main(threads: int, rounds: int) -> None:
    """Time each image by each implementation, interleaved."""
    torch.set_num_threads(threads)
    click.echo(f"variant {native.variant()}, half {native.has_half()}, {threads} threads, medians of {rounds} rounds")
    for name, (config, h, w) in CASES.items():
        functions = implementations(config, h, w, threads)
        times = np.empty((rounds, len(functions)))
        for row in times:
            for i, function in enumerate(functions):
                begun = time.perf_counter()
                function()
                row[i] = time.perf_counter() - begun
        fast, half, slow = np.median(times, axis=0) * 1e3
        click.echo(
            f"{name:30} compiled {fast:6.1f} ms, half {half:6.1f} ms, torch {slow:7.1f} ms, "
            f"ratios {slow / fast:4.1f} and {slow / half:4.1f}"
        )


if __name__ == "__main__":
    main()
