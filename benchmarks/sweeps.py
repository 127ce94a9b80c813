"""What a sweep costs beside one variant and what differs: an actor is there in a few frames, elsewhere in each variant.

    python -m benchmarks.sweeps out/street --variants 30 --frames 4

Processor time of one process without threads: other processes hardly change it.
"""

from __future__ import annotations

import json
import tempfile
import time
from pathlib import Path

import click

from unisim_blender.core.batch.jobs import read_jobs
from unisim_blender.core.batch.plan import plan_batch
from unisim_blender.core.batch.records import Store
from unisim_blender.core.batch.report import batch_report
from unisim_blender.core.batch.run import run_batch
from unisim_blender.core.executors import EXECUTORS
from unisim_blender.core.prepare.scenario_plan import RenderOptions

FRAME_S = 0.1


def sweep(log: Path, folder: Path, variants: int, frames: int, actor: str) -> Path:
    """Write a sweep in which a copy of an actor is there in the log's last frames."""
    start_s = 1.9 - FRAME_S * (frames - 0.5)
    copy = {
        "type": "duplicate", "actor": actor, "id": "copy", "present": {"start_s": start_s},
        "pose": {"position": [32.0, 0.0, 0.725]},
    }  # fmt: skip
    scenario = {"format": "unisim-scenario", "version": 1, "name": "sweep", "log": str(log.absolute()), "edits": [copy]}
    aside = {"at": "/edits/0/pose/position/1", "range": {"start": -2.0, "stop": 2.0, "count": variants}}
    document = {
        "format": "unisim-sweep",
        "version": 1,
        "name": "sweep",
        "scenario": scenario,
        "parameters": {"y": aside},
    }
    path = folder / f"{variants}.json"
    path.write_text(json.dumps(document))
    return path


@click.command()
@click.argument("log", type=click.Path(path_type=Path))
@click.option("--variants", default=30, show_default=True)
@click.option("--frames", default=4, show_default=True, help="In which the actor is there.")
@click.option("--actor", default="car-01", show_default=True)
@click.option("--width", default=240, show_default=True)
def main(log: Path, variants: int, frames: int, actor: str, width: int) -> None:
    """Print processor seconds of one variant, and of all."""
    options = RenderOptions(sensors=("front_camera",), width=width, quality="fast", renderer="surfel")
    with tempfile.TemporaryDirectory() as name:
        for count in (1, 1, variants):  # the first one loads what is kept
            jobs = read_jobs([sweep(log, Path(name), count, frames, actor)])
            begun = time.process_time()
            plan = plan_batch(jobs, options)
            planned = time.process_time()
            store = Store(f"memory://{name}/{count}-{begun}")
            run_batch(plan, store, EXECUTORS["this-process"])
            ran = time.process_time()
            batch_report(store)
            told = time.process_time()
            print(
                f"{count} variants: {plan.asked} images asked for, {plan.rendered} rendered; planned in "
                f"{planned - begun:.2f} s, run in {ran - planned:.2f} s, of which the report {told - ran:.2f} s"
            )


if __name__ == "__main__":
    main()
