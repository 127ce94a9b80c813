"""`unisim render`: a scenario's camera images, sweeps and labels into a folder."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import click

from ... import cuda_driver
from ...errors import UnisimError
from ...executors import EXECUTORS
from ...export.formats import check_formats, write_sequence
from ...prepare.renderers import RENDERERS, UNTRAINED_DEFAULT
from ...prepare.scenario_plan import RenderOptions, plan_scenario, sequence_formats
from ...prepare.selection import split_names
from ...progress import Bar
from ...scenario.types import SEQUENCE_FORMATS
from ...sensors.error_bound import parse_bounds
from ...sensors.frames import FORMER_PASSES
from ...sequence.run import MANIFEST_NAME, render_sequence
from ..options import SourceParam, out_option, render_options

MOST_JOBS = 8
"""Processes that are started unasked: each holds the scene."""


@click.command()
@click.argument("scenario", type=SourceParam())
@out_option()
@click.option("--frames", metavar="START:STOP:STEP", help="Frames by number, or one number. [default: the scenario's]")
@click.option(
    "--times",
    metavar="START:STOP:RATE",
    help="Seconds and a rate a second, in place of frames. [default: the scenario's]",
)
@click.option(
    "--passes",
    metavar="A,B",
    help="rgb, depth, normal, instance, opacity, unsupported, confidence. [default: the scenario's, or rgb]",
)
@render_options(
    "the scenario's",
    list(RENDERERS.with_plugins()),
    width="Width of the images; heights follow.",
    renderer="; ".join(f"{kind.name}: {kind.about}" for kind in RENDERERS.with_plugins().values())
    + f". [default: what the scene was trained as, or {UNTRAINED_DEFAULT.name} where the scenario names no trained scene]",
    scene="the one that the scenario names",
)
@click.option(
    "--max-error",
    metavar="ERROR",
    multiple=True,
    help="Instead of --quality, the cheapest settings that keep every frame to it: 1mm (a sweep's median depth error) or another "
    "percentile of it (p90:20mm), 40dB (an image's PSNR), 1.5dE (its mean colour difference). Several, one option each.",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    help=f"Processes, of one thread each. [default: one a GPU, or a core, at most {MOST_JOBS}]",
)
@click.option(
    "--executor",
    type=click.Choice(list(EXECUTORS)),
    help="Where frames are rendered. [default: processes, or this-process where one is enough]",
)
@click.option("--resume", is_flag=True, help="Continue a render; finished frames whose inputs did not change are kept.")
@click.option(
    "--format",
    "formats",
    type=click.Choice(list(SEQUENCE_FORMATS)),
    multiple=True,
    help="Write the whole in this format, too. "
    + "; ".join(f"{name}: {about}" for name, about in SEQUENCE_FORMATS.items())
    + ". Several, one option each.",
)
@click.option("--video", is_flag=True, help="As --format video.")
@click.option(
    "--draw",
    metavar="SEED",
    type=click.IntRange(min=0),
    help="Draw whether a LiDAR beam returns from its probability. [default: it returns where that is half or more]",
)
@click.option("--sources", metavar="START:STOP:STEP", help="Frames that surfel and warp may look at. [default: all]")
def command(
    scenario: Path | str,
    out: Path,
    passes: str | None,
    options: RenderOptions,
    max_error: tuple[str, ...],
    jobs: int | None,
    executor: str | None,
    resume: bool,
    formats: tuple[str, ...],
    video: bool,
    **more: Any,
) -> None:
    """Render SCENARIO's sensors, or a log's, into a folder: images, sweeps, labels and a manifest."""
    if options.quality and max_error:
        raise UnisimError(f"--quality {options.quality} and --max-error {max_error[0]}: give one of the two")
    options = replace(options, passes=pass_names(passes), max_error=parse_bounds(max_error), **more)
    plan, prepared = plan_scenario(scenario, options)
    wanted = {*sequence_formats(prepared.scenario), *formats, *(("video",) if video else ())}
    check_formats(wanted, plan.settings, scenario)
    for sentence in plan.about.get("warnings", ()):
        click.echo(f"Warning: {sentence}", err=True)
    with Bar(total=1.0, bar_format="{desc}: {percentage:3.0f}%|{bar}| {elapsed}", dynamic_ncols=True, delay=0.5) as bar:
        for step in plan.recipe.steps():
            bar.set_description_str(step.text, refresh=False)
            bar.update(step.share - bar.n)
    with Bar(total=len(plan.moments), unit="frame", dynamic_ncols=True, smoothing=0.1) as bar:
        report = render_sequence(
            plan,
            out,
            jobs or default_jobs(plan.settings.device),
            resume,
            on_moment=lambda key: bar.update(),
            on_reused=bar.update,
            executor=EXECUTORS[executor] if executor else None,
        )
    for name in SEQUENCE_FORMATS:
        if name in wanted:
            write_sequence(name, plan, out)
    if report.broken:
        many, wanted_errors = len(report.broken), ", ".join(plan.settings.max_error)
        sentence = f"{many} images and sweeps may not keep {wanted_errors}, though rendered at the finest settings"
        click.echo(f"Warning: {sentence}: {out / MANIFEST_NAME}", err=True)
    earlier = f", {len(report.kept)} were there already" if report.kept else ""
    parts = f" ({report.captures} images and sweeps, {report.captures_kept} kept)" if report.captures_kept else ""
    click.echo(f"{len(report.rendered)} frames rendered in {report.seconds:.1f} s{earlier}{parts}: {out}")


def pass_names(text: str | None) -> tuple[str, ...] | None:
    """The names of a comma-separated list of passes, current ones in place of former ones, of which
    standard error is told."""
    names = split_names(text)
    for name in names or ():
        if name in FORMER_PASSES:
            click.echo(f"Warning: --passes {name}: this pass is now called {FORMER_PASSES[name]}", err=True)
    return names and tuple(FORMER_PASSES.get(name, name) for name in names)


def default_jobs(device: str) -> int:
    """One process a GPU, or a core, within reason."""
    if device.startswith("cuda"):
        return 1 if ":" in device else max(1, cuda_driver.count())
    return min(os.cpu_count() or 1, MOST_JOBS)
