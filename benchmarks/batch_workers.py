"""What a batch costs by number of workers, in processes and on a Ray that is started for it.

    python -m benchmarks.batch_workers --folder out/workers
    python -m benchmarks.batch_workers --folder out/workers --empty 500 --rounds 0

Runs take turns, so that what else the machine does meets all of them. With ``--empty`` so many units that do nothing show
what handing out costs: seconds until the first is back, and milliseconds for each further one.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

import click

from benchmarks.batch_kills.sweep import batch, write_sweep
from unisim_blender.core.executors import EXECUTORS

PLACES = ("processes", "ray")


def make_nothing() -> Callable[[int], int]:
    """Make a function that does nothing."""
    return int


def handing_out(on: str, workers: int, units: int) -> tuple[float, float]:
    """Seconds until the first of so many empty units is back, and milliseconds for each further one."""
    began, times = time.monotonic(), []
    for _ in EXECUTORS[on].run(make_nothing, range(units), workers):
        times.append(time.monotonic() - began)
    return times[0], 1e3 * (times[-1] - times[0]) / (units - 1)


def run_seconds(folder: Path, on: str, workers: int) -> tuple[float, int]:
    """Seconds of a batch, from its plan to its manifest, and how many captures it rendered."""
    out = folder / f"{on}-{workers}"
    shutil.rmtree(out, ignore_errors=True)
    command = batch(folder / "sweep.json", str(out), "--on", on, "--jobs", str(workers))
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
    report = json.loads(done.stdout.splitlines()[-1])
    return report["seconds"], report["captures_run"]


@click.command()
@click.option("--folder", type=click.Path(path_type=Path), required=True, help="Where all is written.")
@click.option("--scenarios", type=int, default=4, show_default=True)
@click.option("--frames-each", type=int, default=20, show_default=True, help="Frames of each that no other has, of 20.")
@click.option("--workers", type=int, multiple=True, default=(1, 2), show_default=True)
@click.option("--rounds", type=int, default=3, show_default=True)
@click.option("--empty", type=int, default=0, help="Hand out so many units that do nothing, too.")
def main(folder: Path, scenarios: int, frames_each: int, workers: tuple[int, ...], rounds: int, empty: int) -> None:
    """Measure batches in processes and on Ray, by number of workers."""
    folder.mkdir(parents=True, exist_ok=True)
    write_sweep(folder, scenarios, frames_each)
    cells = [(on, count) for count in workers for on in PLACES]
    if empty:
        click.echo("| on | workers | first unit, s | each further, ms |\n|---|---|---|---|")
        for on, count in cells:
            first, each = handing_out(on, count, empty)
            click.echo(f"| {on} | {count} | {first:.1f} | {each:.2f} |")
    seconds: dict[tuple[str, int], list[float]] = {cell: [] for cell in cells}
    captures = 0
    for _ in range(rounds):
        for cell in cells:
            taken, captures = run_seconds(folder, *cell)
            seconds[cell].append(taken)
            click.echo(f"{cell[0]}, {cell[1]} workers: {taken:.1f} s", err=True)
    if rounds:
        click.echo("| on | workers | seconds, median | all | captures a second |\n|---|---|---|---|---|")
        for (on, count), taken_s in seconds.items():
            all_s = ", ".join(f"{one:.0f}" for one in taken_s)
            click.echo(f"| {on} | {count} | {median(taken_s):.1f} | {all_s} | {captures / median(taken_s):.2f} |")


if __name__ == "__main__":
    main()
