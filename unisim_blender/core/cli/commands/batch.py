"""`unisim batch`: many scenarios, rendered or driven through, into one folder or object store."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ...batch.manifest import whole_place
from ...batch.plan import MOMENTS_PER_UNIT
from ...batch.schedulers import SCHEDULERS, ShardedBatch
from ...batch.status import clock_text
from ...errors import UnisimError
from ...executors import EXECUTORS, RayCluster, executor_at
from ...files import write_file
from ...prepare.renderers import RENDERERS
from ...prepare.scenario_plan import RenderOptions
from ...progress import Bar
from ...scenario.types import SEQUENCE_FORMATS
from ..options import render_options
from ._batch_progress import BatchProgress
from .render import MOST_JOBS, default_jobs, pass_names

if TYPE_CHECKING:
    from ...batch.plan import Unit
    from ...batch.run import BatchReport, Failure
    from ...executors.executor import WorkerState

STATUS, REPORT, SHARDS = "status", "report", "shards"
MOST_SHARDS = 100
"""Without a number of them."""
_OTHERWISE = ("on", "resume", "units", "as_json", "scheduler", "shards", "image")
"""Options that a shard's command does not have from the command that wrote it."""


def shard_of(context: click.Context, option: click.Parameter, value: str | None) -> tuple[int, int] | None:
    """Return which part of a batch 0/20 is: its number, and how many there are."""
    if value is None:
        return None
    number, _, count = value.partition("/")
    if not (number.isdecimal() and count.isdecimal() and int(number) < int(count)):
        raise click.BadParameter(f"{value!r} is no part of a batch: 0/20 is the first of 20, and 19/20 the last")
    return int(number), int(count)


@click.command("batch")
@click.argument("jobs_", metavar="JOBS...", nargs=-1, required=True)
@click.option("--out", metavar="URL", help="Folder or object store to write: out/batch, s3://bucket/batch. [required]")
@click.option(
    "--on",
    metavar="|".join([*EXECUTORS, "ray://HOST:PORT", SHARDS]),
    default="processes",
    show_default=True,
    help="Where units are run. ray: the cluster of RAY_ADDRESS, or this machine. shards: print what a scheduler takes.",
)
@click.option(
    "--jobs",
    type=click.IntRange(min=1),
    help="Workers, of one thread each. "
    f"[default: one a GPU, or a core, here at most {MOST_JOBS}; all that a cluster has room for]",
)
@click.option(
    "--gpus-per-worker",
    type=click.FloatRange(min=0, min_open=True),
    help="GPUs that Ray gives each worker, or the share of one. [default: 1 with --device cuda]",
)
@click.option("--resume", is_flag=True, help="Continue a batch that was interrupted; finished units are kept.")
@click.option(
    "--unit", type=click.IntRange(min=1), default=MOMENTS_PER_UNIT, show_default=True, help="Moments of a unit."
)
@click.option(
    "--units",
    metavar="I/N",
    callback=shard_of,
    help="Run one of N parts of the units; others may run beside it. Resumes.",
)
@click.option(
    "--scheduler",
    type=click.Choice(list(SCHEDULERS)),
    default="slurm",
    show_default=True,
    help="Of --on shards: whose file is printed.",
)
@click.option(
    "--shards", type=click.IntRange(min=1), help=f"Of --on shards. [default: one a unit, at most {MOST_SHARDS}]"
)
@click.option(
    "--image", default="unisim", show_default=True, help="Of --on shards, for kubernetes: the container's image."
)
@click.option("--driver", metavar="NAME", help="Drive through scenarios that name no driver; as of `unisim drive`.")
@click.option("--seed", type=click.IntRange(min=0), help="Of rollouts that name none.")
@click.option("--frames", metavar="START:STOP:STEP", help="Frames by number. [default: the scenarios']")
@click.option("--passes", metavar="A,B", help="As of `unisim render`.")
@render_options("the scenarios'", list(RENDERERS.with_plugins()), without=("boxes",))
@click.option(
    "--format",
    "formats",
    type=click.Choice(list(SEQUENCE_FORMATS)),
    multiple=True,
    help="Write every variant as a whole in this format, too: as of `unisim render`, and video. Several, one option each.",
)
@click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON object a line: the start, workers, units, the report."
)
def command(
    jobs_: tuple[str, ...],
    out: str | None,
    on: str,
    jobs: int | None,
    gpus_per_worker: float | None,
    resume: bool,
    unit: int,
    units: tuple[int, int] | None,
    scheduler: str,
    shards: int | None,
    image: str,
    driver: str | None,
    seed: int | None,
    frames: str | None,
    passes: str | None,
    options: RenderOptions,
    formats: tuple[str, ...],
    as_json: bool,
) -> None:
    """Render many scenarios, or drive through them: files, logs, JSON lines (.jsonl) or sweeps.

    A capture that several share is rendered once. `unisim batch status URL` tells how far a batch is, and
    `unisim batch report URL [--out FILE]` writes its report.
    """
    from ...batch.jobs import read_jobs
    from ...batch.plan import Shard, plan_batch
    from ...batch.records import Store
    from ...batch.run import run_batch

    if jobs_[0] == STATUS and len(jobs_) == 2 and out is None:
        _show_status(Store(jobs_[1]), as_json)
        return
    if jobs_[0] == REPORT and len(jobs_) == 2:
        _write_report(Store(jobs_[1]), out)
        return
    if out is None:
        raise click.UsageError("Missing option '--out'.")
    store = Store(out)
    if gpus_per_worker is None:
        gpus_per_worker = 1.0 if options.device.startswith("cuda") else 0.0
    executor = executor_at("processes" if on == SHARDS else on, gpus_per_worker)
    if jobs is None and not (isinstance(executor, RayCluster) and executor.named):
        jobs = default_jobs(options.device)
    if store.seen_by_its_process_only and on != "this-process":
        raise UnisimError(f"{out}: is of one process alone; give --on this-process")
    options = replace(options, frames=frames, passes=pass_names(passes))
    wanted = read_jobs(jobs_, driver, seed)
    if frames is not None and any(job.driver for job in wanted):
        raise UnisimError(f"--frames {frames}: a rollout has times of its own, not frames")
    with Bar(total=len(wanted), unit="scenario", dynamic_ncols=True, delay=0.5) as bar:
        plan = plan_batch(wanted, options, unit, formats, on_job=lambda job: bar.update())
    for variant in plan.variants:
        for sentence in variant.about.get("warnings", ()):
            click.echo(f"Warning: {variant.job.name}: {sentence}", err=True)
    if on == SHARDS:
        show_shards(click.get_current_context(), len(plan.units))
        return
    shard = None if units is None else Shard(*units)
    total = len(plan.units) + len(plan.with_formats()) if shard is None else len(shard.of(plan.units))
    with BatchProgress(total) as progress:

        def on_unit(done: Unit, failure: Failure | None) -> None:
            progress.on_unit(done, failure)
            if as_json:
                reason = failure and failure.reason
                _print_json({"event": "unit", "unit": done.name, "variant": done.variant, "failure": reason})

        def on_kept(count: int) -> None:
            begins = not progress.begun
            progress.on_kept(count)
            if as_json and begins:
                _print_json({"event": "start", "units": progress.total, "kept": count})

        def on_worker(state: WorkerState, unit: Unit | None) -> None:
            progress.on_worker(state, unit)
            if as_json:
                name, loads = unit and unit.name, state.loads_scene
                values = {"worker": state.number, "state": state.doing, "unit": name, "loads_scene": loads}
                _print_json({"event": "worker", **values})

        report = run_batch(plan, store, executor, jobs, resume, on_unit, on_kept, progress.on_step, shard, on_worker)
    if as_json:
        _print_json({"event": "report", **asdict(report)})
    else:
        _show(report, out)
    if report.failures:
        raise UnisimError(f"{len(report.failures)} of {report.units} units failed; repeat them with --resume: {out}")


def _show(report: BatchReport, out: str) -> None:
    for failure in report.failures:
        click.echo(f"{failure.variant}, unit {failure.unit}: {failure.reason}\n  {failure.command}", err=True)
    counts = f"{report.asked} captures asked for, {report.rendered} rendered, {report.shared} shared"
    earlier = f", {report.units_kept} were there already" if report.units_kept else ""
    click.echo(f"{counts}; {report.units_run} units run in {report.seconds:.1f} s{earlier}: {out}")


def _write_report(store: Any, out: str | None) -> None:
    """Write a batch's report into its store, or into another file."""
    from ...batch.report import REPORT_NAME, batch_report, write_report

    if out is None:
        write_report(store)
    else:
        write_file(Path(out), batch_report(store, beside=False))
    click.echo(store.where(REPORT_NAME) if out is None else out)


def _show_status(store: Any, as_json: bool) -> None:
    from ...batch.status import batch_status

    status = batch_status(store)
    if as_json:
        _print_json(status)
        return
    captures = status["captures"]
    left = "" if status["seconds_left"] is None else f", {clock_text(status['seconds_left'])} left at this pace"
    click.echo(f"{status['finished']} of {status['units']} units finished, {len(status['failures'])} failed{left}")
    if status["seconds_since_last"] is not None and status["finished"] < status["units"]:
        click.echo(f"The last one was finished {clock_text(status['seconds_since_last'])} ago.")
    click.echo(f"{captures['asked']} captures asked for, {captures['rendered']} to render, {captures['shared']} shared")
    for failure in status["failures"]:
        click.echo(f"{failure['variant']}, unit {failure['unit']}: {failure['reason']}\n  {failure['command']}")
    if not status["manifest"]:
        click.echo("The manifest is not written yet: the batch runs, or continues with --resume.")


def _print_json(values: dict[str, Any]) -> None:
    click.echo(json.dumps(values))


def show_shards(context: click.Context, units: int) -> None:
    """Print what the scheduler takes that the command names. ``units`` are those of the batch."""
    given = context.params
    count = given["shards"] or max(1, min(units, MOST_SHARDS))
    gpus = 1 if given["device"].startswith("cuda") else 0
    label = _label(Path(given["jobs_"][0]).stem)
    batch = ShardedBatch(label, list(_words(context)), count, given["jobs"] or 1, given["image"], gpus)
    click.echo(SCHEDULERS[given["scheduler"]](batch), nl=False)


def _label(text: str) -> str:
    """Return a name that every scheduler takes."""
    letters = "".join(letter if letter.isascii() and letter.isalnum() else "-" for letter in text)
    return f"unisim-{letters.strip('-')[:40]}".strip("-")


def _words(context: click.Context) -> Iterator[str]:
    """Yield the command as it was given, with whole paths, for another folder and machine."""
    yield from ("unisim", "batch")
    yield from (whole_place(name) for name in context.params["jobs_"])
    for option in context.command.params:
        source = context.get_parameter_source(option.name or "")
        if not isinstance(option, click.Option) or option.name in _OTHERWISE:
            continue
        if source is not click.core.ParameterSource.COMMANDLINE:
            continue
        value = context.params[option.name or ""]
        if option.is_flag:
            yield option.opts[0]
            continue
        for item in value if option.multiple else (value,):
            yield option.opts[0]
            yield whole_place(item) if isinstance(item, Path) or option.name == "out" else str(item)
