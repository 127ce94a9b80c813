"""A training step by the compiled kernels beside the same step in plain torch: interleaved, the same batches;
medians, their ratio.

python benchmarks/training.py LOG [--camera NAME] [--width W] [--preset NAME] [--threads T] [--warm N] [--rounds R]

Every term of the loss is on from the start. Each pair of steps draws the same batch; the weights go on
from step to step.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from unittest.mock import patch

import click
import numpy as np
import torch

from unisim_blender.core import native
from unisim_blender.core.formats.readers import open_log
from unisim_blender.core.training.config import TrainConfig
from unisim_blender.core.training.trainer import Trainer


def timed(trainer: Trainer, iteration: int, compiled: bool) -> float:
    """Seconds of one step on the batch of an iteration."""
    trainer.iteration = iteration
    with patch.object(native, "library", native.library if compiled else lambda: None):
        begun = time.perf_counter()
        trainer.step()
        return time.perf_counter() - begun


@click.command()
@click.argument("log", type=click.Path(exists=True, path_type=Path))
@click.option("--camera", default="front_camera", show_default=True)
@click.option("--width", default=640, show_default=True)
@click.option("--preset", default="small", show_default=True)
@click.option("--threads", default=2, show_default=True)
@click.option("--warm", default=20, show_default=True, help="Compiled steps before the first that counts.")
@click.option("--rounds", default=12, show_default=True)
def main(log: Path, camera: str, width: int, preset: str, threads: int, warm: int, rounds: int) -> None:
    """Time steps of a training on LOG, a multiple of four rounds: every fourth step also updates poses and
    the hypernetwork."""
    torch.set_num_threads(threads)
    recorded = open_log(log)
    lidars = tuple(name for name in recorded.drive.lidars if recorded.drive.lidars[name].model.beams)
    config = TrainConfig(
        (camera,), lidars, tuple(recorded.drive.frames)[::2], width, preset, iterations=10_000,
        perceptual_from=0.0, poses_from=0.0, unobserved_from=0.0, settled_from=0.0, prune_from=0,
    )  # fmt: skip
    trainer = Trainer(recorded, config)
    for iteration in range(warm):
        timed(trainer, iteration, compiled=True)
    pairs = [[timed(trainer, warm + i, compiled) for compiled in (True, False)] for i in range(rounds)]
    times = np.array(pairs)
    fast, slow = np.median(times, axis=0)
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan")
    click.echo(
        f"variant {native.variant()}, {threads} threads, {rounds} rounds, load {load:.1f}: {1e3 * fast:.0f} ms a step "
        f"({1 / fast:.1f} a second), torch {1e3 * slow:.0f} ms, ratio {np.median(times[:, 1] / times[:, 0]):.1f}"
    )


if __name__ == "__main__":
    main()
