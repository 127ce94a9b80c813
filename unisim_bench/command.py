"""`unisim bench`: run time against error of everything that renders, side by side."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

SAMPLE = Path("sample") / "scene"


@click.command()
@click.option(
    "--scene",
    "scenes",
    multiple=True,
    type=click.Path(path_type=Path),
    default=[SAMPLE],
    show_default=True,
    help="A trained scene. The first is measured in full, further ones for what a scene's size costs.",
)
@click.option(
    "--log", type=click.Path(path_type=Path), help="The first scene's log: recorded images are beside rendered ones."
)
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("out/bench"), show_default=True, help="Folder to write."
)
@click.option(
    "--rounds", type=click.IntRange(min=1), help="How often everything is rendered. [default: 3; 1 with --quick]"
)
@click.option("--quick", is_flag=True, help="Fewer and smaller images: a look, nothing to be quoted.")
def command(scenes: tuple[Path, ...], log: Path | None, out: Path, rounds: int | None, quick: bool) -> None:
    """Measure rendering: seconds against error of every tracer, quality and instruction set; growth; memory.

    Everything takes turns, and medians count. Ctrl-C leaves what was measured so far.
    """
    from .run import run_bench
    from .settings import QUICK, Settings

    settings = QUICK if quick else Settings()
    run_bench(scenes, log, out, replace(settings, rounds=rounds or settings.rounds), click.echo)
