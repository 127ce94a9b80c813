"""`unisim synth`: a log of a procedural street whose truth is known."""

from __future__ import annotations

import os
from pathlib import Path

import click


@click.command("synth")
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--frames", default=20, show_default=True, help="Frames, ten a second.")
@click.option("--width", default=480, show_default=True, help="Width of the images, pixels.")
@click.option("--height", default=270, show_default=True, help="Height of the images, pixels.")
@click.option("--seed", default=0, show_default=True, help="Which street.")
@click.option("--cameras", default="front_camera", show_default=True, help="PandaSet's names, separated by commas.")
@click.option("--range-noise", default=0.01, show_default=True, help="Deviation of the recorded LiDAR ranges, metres.")
@click.option("--jobs", type=click.IntRange(1), default=None, help="Processes; by default one a core.")
@click.option("--quiet", is_flag=True, help="No progress bar.")
def command(
    out: Path,
    frames: int,
    width: int,
    height: int,
    seed: int,
    cameras: str,
    range_noise: float,
    jobs: int | None,
    quiet: bool,
) -> None:
    """Write a log of a procedural street to the folder OUT, in PandaSet's layout.

    OUT/street.json is its recipe: from it the same street is built again, and the truth of any edit of the log rendered.
    """
    from ..street.street import build_street
    from ..street.write import write_log

    names = tuple(name.strip() for name in cameras.split(",") if name.strip())
    street = build_street(seed, frames, width, height, names, range_noise)
    write_log(street, out, jobs or os.cpu_count() or 1, progress=not quiet)
    click.echo(f"{out}: {frames} frames of street {seed}, {len(street.drive.actors)} actors; recipe in {out / 'street.json'}")
