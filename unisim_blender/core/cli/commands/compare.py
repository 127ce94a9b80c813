"""`unisim compare`: our method, its ablations and the baselines in one table."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from ...data.moved import Choice
from ...evaluation.comparison.methods import ABLATIONS, BASELINES, OURS, USUAL
from ...prepare.selection import split_names
from ...progress import Bar
from ..options import PATH, QUALITY, out_option, posed, poses_option


@click.command()
@click.argument("log", type=PATH)
@out_option("Folder of scenes, metrics, tables and the page.")
@click.option(
    "--methods",
    metavar="A,B",
    help=f"Ours: {', '.join(OURS)}; ablations: {', '.join(ABLATIONS)}; baselines: {', '.join(BASELINES)}; or all. "
    f"[default: {', '.join(USUAL)}]",
)
@click.option("--minutes", type=float, default=10.0, show_default=True, help="Of each training.")
@click.option("--iterations", type=click.IntRange(min=1), help="Steps of each training, instead of minutes.")
@click.option("--frames", default="::2", show_default=True, help="Frames to learn from; the others are compared.")
@click.option(
    "--cameras", help="Cameras, separated by commas. [default: front_camera, or else the one that looks ahead]"
)
@click.option("--width", type=click.IntRange(min=16), default=320, show_default=True, help="Width of the images.")
@click.option("--truth-frames", type=click.IntRange(min=1), default=8, show_default=True, help="Frames of each edit.")
@click.option(
    "--scenario",
    "scenarios",
    multiple=True,
    type=PATH,
    help="An edit of the street; several, one option each. [default: LOG/scenarios, or the usual ones]",
)
@click.option(
    "--disturb",
    type=(click.FloatRange(min=0.0), click.FloatRange(min=0.0)),
    metavar="METRES DEGREES",
    help="Train on moving actors' boxes with noise, and tell how much of it is taken back.",
)
@poses_option("auto")
@click.option("--quality", type=QUALITY, default="balanced", show_default=True, help="Samples a ray.")
@click.option("--lpips", metavar="FILE", type=PATH, help="Weights of LPIPS, to measure it.")
@click.option("--fid", metavar="FILE", type=PATH, help="TorchScript of Inception, to measure FID.")
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda or mps.")
@click.option("--seed", type=int, default=0, show_default=True, help="Seed of every random choice.")
@click.option("--quiet", is_flag=True, help="No progress bars.")
def command(log: Path, out: Path, poses: Choice, quiet: bool, **given: Any) -> None:
    """Train methods on the drive at LOG, each within a budget, and compare what they render: replay, lane
    shifts and edits.

    A street's edits are compared with their truth; of a real log, replay alone has one. Everything is kept in the
    folder: the same command goes on where it was cut off, and one with more methods adds rows to the table.
    """
    from ...evaluation.comparison.methods import CompareOptions
    from ...evaluation.comparison.run import compare

    if not given["minutes"] > 0:
        raise click.UsageError("--minutes must be positive")
    names = {"methods": split_names(given["methods"]), "cameras": split_names(given["cameras"]) or ()}
    options = CompareOptions(**given | names | {"scenarios": given["scenarios"] or None})

    def progress(items: Iterable[int], what: str) -> Iterable[int]:
        return Bar(items, desc=what, unit="frame", dynamic_ncols=True, disable=quiet)

    def say(sentence: str) -> None:
        click.echo(sentence, err=True)

    click.echo(compare(log, out, options, lambda recorded: posed(recorded, poses, quiet), say, progress, quiet))
    click.echo(f"Table: {out / 'comparison.md'}   page: {out / 'index.html'}")
