"""Train the stack's detectors on exact procedural streets: python -m examples.perception.train --help."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import click
import torch

from benchmarks.detection.samples import settings, write_set
from benchmarks.detection.streets import StreetSet
from benchmarks.detection.training import train
from unisim_blender.core.errors import UnisimError

LENGTH, STEP = 40, 8
"""Frames of each street's drive, and every how many there is a sample."""
BATCH = 6
"""Samples a step."""


@click.command(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 120})
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--seed", default=0, show_default=True, help="Of the training; also the first street's, from 100 on.")
@click.option("--streets", default=20, show_default=True, help="How many streets; five samples each.")
@click.option("--lidar-steps", default=300, show_default=True)
@click.option("--camera-steps", default=450, show_default=True)
def main(out: Path, seed: int, streets: int, lidar_steps: int, camera_steps: int) -> None:
    """Render samples of streets and train both detectors in folder OUT, each in a process of its own. What is there
    already is kept, and a training that was interrupted goes on."""
    first = 100 + seed * streets
    frames = StreetSet(tuple(range(first, first + streets)), LENGTH, STEP, varied=True)
    samples = out / "samples"
    write_set(samples, {"streets": settings(frames)}, frames.keys, frames.sample)
    steps = {"lidar": lidar_steps, "camera": camera_steps}
    with ProcessPoolExecutor(len(steps), multiprocessing.get_context("spawn")) as pool:
        for done in [pool.submit(_train, name, samples, out / name, count, seed) for name, count in steps.items()]:
            done.result()


def _train(name: str, samples: Path, out: Path, steps: int, seed: int) -> None:
    torch.set_num_threads(1)
    train(name, [samples], out, steps, BATCH, seed)


if __name__ == "__main__":
    try:
        main(prog_name="python -m examples.perception.train")
    except UnisimError as error:
        raise SystemExit(f"Error: {error}") from error
