"""`unisim eval`: how far a trained scene's frames are from recorded ones, or edited frames from a street's truth."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ...data.splits import SPLITS
from ...prepare.selection import split_names
from ...progress import Bar
from ..options import PATH, QUALITY, out_option

HELD_OUT = "1::2"
"""Frames that a split is measured on: even frames train, odd frames test."""

LEFT_TO_THE_FILE = ("by_sensor", "pixels", "chamfer_squared_m2", "depth_median_squared_m2")
"""Metrics that are written and not printed."""


@click.command()
@click.argument("paths", nargs=-1, metavar="SCENE LOG | SCENARIO...", type=PATH)
@out_option("Folder for metrics.json, index.html and images.")
@click.option("--truth", metavar="STREET", type=PATH, help="Measure scenarios against this street's truth.")
@click.option("--scene", type=PATH, help="With --truth: the trained scene, in place of those that scenarios name.")
@click.option("--frames", metavar="START:STOP:STEP", help="Frames by number. [default: those that were not trained on]")
@click.option("--cameras", metavar="A,B", help="Cameras by name. [default: those that were trained on]")
@click.option(
    "--width", type=click.IntRange(min=16), help="Width of the images. [default: the width that was trained at]"
)
@click.option(
    "--split", type=click.Choice(sorted(SPLITS)), help="SCENE and LOG hold a folder for each log of this split."
)
@click.option("--shifts", is_flag=True, help="Measure what a detector sees from -3 to 3 m beside the path of LOG.")
@click.option("--detector", metavar="MODULE:FUNCTION", help="With --shifts: returns the detector.")
@click.option("--beside", metavar="A,B", help="With --shifts: surfel, warp, or folders of scenes, measured too.")
@click.option("--quality", type=QUALITY, default="balanced", show_default=True, help="Samples a ray.")
@click.option("--detail", is_flag=True, help="Add the detail of those images of LOG that the scene was trained on.")
@click.option("--lpips", "lpips_weights", metavar="FILE", type=PATH, help="Weights of LPIPS, to measure it.")
@click.option("--device", default="cpu", show_default=True, help="cpu, cuda or mps.")
def command(
    paths: tuple[Path, ...],
    out: Path,
    truth: Path | None,
    scene: Path | None,
    split: str | None,
    shifts: bool,
    detector: str | None,
    beside: str | None,
    **given: Any,
) -> None:
    """Render held-out frames of SCENE and compare them with LOG; with --truth, compare SCENARIOs with
    a street's truth; with --shifts, count what a detector sees in views beside the path."""
    from ...evaluation.recorded_runs import EvaluationOptions, evaluate_scene, evaluate_split, flat_metrics

    options = EvaluationOptions(**given | {"cameras": split_names(given["cameras"])})
    if (detector is None) is shifts or (beside is not None and not shifts):
        raise click.UsageError("--shifts, --detector and, if any, --beside go together")
    if shifts:
        from ...evaluation.shifts import ShiftOptions, shift_curve, tables

        if len(paths) != 2 or truth is not None or scene is not None or split is not None:
            raise click.UsageError("--shifts takes a trained scene and a log")
        chosen = ShiftOptions(detector or "", split_names(beside) or ())
        document = shift_curve(*paths, out, options, chosen, _progress)
        click.echo("\n".join(tables(document)))
        click.echo(f"Metrics: {out / 'shifts.json'}   plot: {out / 'shifts.png'}   views: {out / 'views.png'}")
        return
    if truth is not None:
        from ...evaluation.truth_runs import evaluate_scenarios

        if not paths or split is not None:
            raise click.UsageError("--truth takes scenarios, and no --split")
        metrics = evaluate_scenarios(truth, paths, out, options, _progress, scene)
    else:
        if scene is not None:
            raise click.UsageError("--scene goes with --truth: without it, the scene is the first argument")
        if len(paths) != 2:
            raise click.UsageError("eval takes a trained scene and a log, or --truth STREET and scenarios")
        trained, log = paths
        if split is None:
            metrics = evaluate_scene(trained, log, out, options, _progress)
        else:
            options = replace(options, frames=options.frames or HELD_OUT)
            metrics = evaluate_split(SPLITS[split], trained, log, out, options, _progress)
    for name, value in flat_metrics(metrics):
        if not any(part in LEFT_TO_THE_FILE for part in name.split(".")):
            click.echo(f"{name:45} {value}")
    click.echo(f"Metrics: {out / 'metrics.json'}   images: {out / 'index.html'}")


def _progress(frames: Any, what: str) -> Any:
    """The frames behind a bar with frames a second and the time left."""
    return Bar(frames, desc=what, unit="frame", dynamic_ncols=True)
