"""`unisim synth`: a log of a procedural street whose truth is known."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from ..layout import StreetKind

LENSES = ("pinhole", "opencv", "fisheye", "ftheta", "mei")
ENGINES = ("exact", "cycles")
KINDS = ("straight", "night", "curve", "crossing")


@click.command("synth")
@click.argument("out", type=click.Path(path_type=Path))
@click.option("--frames", default=20, show_default=True, help="Frames, ten a second.")
@click.option("--width", default=480, show_default=True, help="Width of the images, pixels.")
@click.option("--height", default=270, show_default=True, help="Height of the images, pixels.")
@click.option("--seed", default=0, show_default=True, help="Which street.")
@click.option("--cameras", default="front_camera", show_default=True, help="PandaSet's names, separated by commas.")
@click.option("--lens", type=click.Choice(LENSES), default="pinhole", show_default=True, help="Of the cameras.")
@click.option("--range-noise", default=0.01, show_default=True, help="Deviation of the recorded LiDAR ranges, metres.")
@click.option("--speed", default=8.0, show_default=True, help="The drive's, metres a second.")
@click.option(
    "--turns",
    default="",
    metavar="DEGREES",
    help="Bends of the street, evenly along the drive, separated by commas: to the left, negative ones to the right.",
)
@click.option("--thin", is_flag=True, help="Add wires, masts, railings and fences.")
@click.option("--lamps", is_flag=True, help="Add a traffic light that changes; the car ahead brakes and indicates.")
@click.option("--kind", type=click.Choice(KINDS), default="straight", show_default=True, help="Of street.")
@click.option("--people", default=0, show_default=True, help="Who walks along the street; the second rides a bicycle.")
@click.option("--engine", type=click.Choice(ENGINES), default="exact", show_default=True, help="Who draws the images.")
@click.option("--paths", default=96, show_default=True, help="Paths a pixel that Cycles traces.")
@click.option(
    "--truth",
    "scenarios",
    multiple=True,
    metavar="SCENARIO",
    type=click.Path(path_type=Path),
    help="Have Cycles draw this scenario's truth too; may be given several times.",
)
@click.option(
    "--edits", is_flag=True, help="Write the usual edits as scenarios to OUT/scenarios; Cycles draws their truth."
)
@click.option("--truth-frames", default=8, show_default=True, help="Frames of each truth, spread over the odd ones.")
@click.option("--jobs", type=click.IntRange(1), default=None, help="Processes; by default one a core.")
@click.option("--quiet", is_flag=True, help="No progress bar.")
def command(
    out: Path,
    frames: int,
    width: int,
    height: int,
    seed: int,
    cameras: str,
    lens: str,
    range_noise: float,
    speed: float,
    turns: str,
    thin: bool,
    lamps: bool,
    kind: StreetKind,
    people: int,
    engine: str,
    paths: int,
    scenarios: tuple[Path, ...],
    edits: bool,
    truth_frames: int,
    jobs: int | None,
    quiet: bool,
) -> None:
    """Write a log of a procedural street to the folder OUT, in PandaSet's layout.

    OUT/street.json is its recipe: from it the same street is built again, and the truth of any edit of the log
    rendered. The engine cycles draws with light that bounces, by Blender's module; what is there already is
    not drawn again.
    """
    from unisim_blender.core.prepare.scenario import prepare_scenario
    from unisim_blender.core.prepare.selection import spread_frames

    from ..drawing.path_tracer import TruthRequest, draw_truths
    from ..street import build_street
    from ..usual_edits import write_scenarios
    from ..write import write_log

    names = tuple(name.strip() for name in cameras.split(",") if name.strip())
    if scenarios and engine == "exact":
        raise click.UsageError("--truth is for --engine cycles: the exact engine draws truth when it is asked for")
    try:
        bends = tuple(float(turn) for turn in turns.split(",") if turn.strip())
    except ValueError as error:
        raise click.UsageError(f"--turns {turns}: are degrees, separated by commas") from error
    street = build_street(
        seed, frames, width, height, names, range_noise, engine, paths, lens, speed, bends, kind, people, thin, lamps
    )
    write_log(street, out, jobs or os.cpu_count() or 1, progress=not quiet)
    if edits:
        scenarios = (*scenarios, *write_scenarios(street, out, out))
    truths = []
    for scenario in scenarios if engine == "cycles" else ():
        drive = prepare_scenario(scenario, refined=False).edited
        truths.append(TruthRequest(scenario.resolve(), spread_frames(drive, truth_frames), tuple(drive.cameras)))
    if truths:
        draw_truths(out, tuple(truths), None, progress=not quiet)
    click.echo(
        f"{out}: {frames} frames of street {seed}, {len(street.drive.actors)} actors; recipe in {out / 'street.json'}"
    )
