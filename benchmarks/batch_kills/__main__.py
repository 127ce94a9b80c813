"""A batch on a Ray cluster whose workers, nodes and command are killed at random, beside one process.

    python -m benchmarks.batch_kills --folder out/kills
    python -m benchmarks.batch_kills --folder out/kills --overhead-rounds 1
    python -m benchmarks.batch_kills --folder out/kills-s3 --to s3 --failing 0.05 --scenarios 20

The scenarios are of the sample's street, so ``out/street`` (`make demo`) and ``sample/scene`` must be there. A head
without cores and two nodes of a core each run on this machine, in a network namespace of its own (`unshare`, root), with
Ray's folders and token below ``--folder``. Only processes that were started here are killed. ``results.json`` has all
figures; what it has of the run in one process and of the overhead is kept when the command is run again with the same
options.
"""

from __future__ import annotations

import json
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

import click

from unisim_blender.core.batch.records import Store
from unisim_blender.core.files import write_file
from unisim_blender.core.json_file import json_bytes
from unisim_blender.core.render.code_identity import code_identity

from .cluster import CLIENT_PORT, HEAD, PORT, Cluster, environment
from .kills import KilledRun, run_alone
from .places import S3_LOG, S3_OUT, S3_SCENE, VARIABLES, digests, requests, s3_server
from .sweep import batch, write_sweep

INSIDE = "UNISIM_KILLS_INSIDE"
NODES = 2


@dataclass(frozen=True)
class Asked:
    """What is run. Equal ones make equal files."""

    scenarios: int
    frames_each: int
    to: str
    code: str


@dataclass
class Measurement:
    """Runs the batches and compares their files; ``figures`` are written to ``results.json`` as they come."""

    folder: Path
    asked: Asked
    variables: dict[str, str]
    sweep: Path
    figures: dict[str, Any]

    def note(self, **figures: Any) -> None:
        """Add figures and write all."""
        self.figures |= figures
        write_file(self.folder / "results.json", json_bytes(self.figures))

    def place(self, name: str) -> str:
        """The folder or URL that a run writes, emptied; on S3 each run has a server of its own, and so the same URL."""
        if self.asked.to == "s3":
            return S3_OUT
        shutil.rmtree(self.folder / name, ignore_errors=True)
        return str(self.folder / name)

    def whole(self) -> None:
        """Run the batch in one process, without Ray, if that was not done yet."""
        if "one_process" in self.figures:
            return
        out = self.place("whole")
        with ExitStack() as stack:
            if self.asked.to == "s3":
                stack.enter_context(s3_server(self.folder, 0.0, 0))
            report = run_alone(
                batch(self.sweep, out, "--on", "this-process"), self.variables, self.folder / "whole.log"
            )
            write_file(self.folder / "whole.json", json_bytes(digests(Store(out))))
        counts = {name: report[name] for name in ("asked", "rendered", "shared", "units")}
        self.note(captures_and_units=counts, one_process={"seconds": round(report["seconds"], 1)})

    def compared(self, out: str) -> dict[str, Any]:
        """Compare all files of a run with those of one process."""
        expected, found = json.loads((self.folder / "whole.json").read_bytes()), digests(Store(out))
        differ = sorted(name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name))
        return {"files": len(expected), "differing_files": len(differ), "differing": differ[:20]}

    def overhead(self, cluster: Cluster, rounds: int) -> None:
        """Run the batch in processes and on the cluster in turns, without kills. Processor time tells more than time
        where other programs run: of Ray it is that of the command, the head, and the nodes with their workers."""
        places = {"processes": "processes", "ray": f"{HEAD}:{PORT}"}
        seconds: dict[str, list[float]] = {name: [] for name in places}
        cpu_s: dict[str, list[float]] = {name: [] for name in places}
        differing = 0
        for number in range(rounds):
            for name, on in places.items():
                out = self.place(f"without-kills-{name}")
                command = batch(self.sweep, out, "--on", on, "--jobs", str(NODES))
                before = _ended_cpu_s()
                with cluster.cpu() as meter:
                    report = run_alone(command, self.variables, self.folder / f"without-kills-{name}.log")
                of_cluster = meter.seconds if name == "ray" else 0.0
                cpu_s[name].append(round(_ended_cpu_s() - before + of_cluster, 1))
                seconds[name].append(round(report["seconds"], 1))
                differing += self.compared(out)["differing_files"]
                click.echo(
                    f"round {number + 1}, {name}: {seconds[name][-1]} s, {cpu_s[name][-1]} s of processors", err=True
                )
        shares = {
            f"ray_over_processes_{kind}": round(median(values["ray"]) / median(values["processes"]) - 1, 4)
            for kind, values in (("seconds", seconds), ("cpu_seconds", cpu_s))
        }
        self.note(overhead={"seconds": seconds, "cpu_seconds": cpu_s, **shares, "differing_files": differing})

    def killed(self, cluster: Cluster, address: str, kills: list[str], chance: random.Random) -> None:
        """Run the batch on the cluster with kills."""
        out, on_s3 = self.place("killed"), self.asked.to == "s3"
        command = batch(self.sweep, out, "--on", address, "--jobs", str(NODES))
        units = self.figures["captures_and_units"]["units"]
        run = KilledRun(cluster, command, Store(out), units, kills, chance, poll_s=1.0 if on_s3 else 0.2)
        figures = run.run()
        counts = {"requests": requests()} if on_s3 else {}
        self.note(killed_run={**figures, **counts, **self.compared(out)})


def _ended_cpu_s() -> float:
    """Processor time of the commands that have ended, and of their workers."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def inside(
    folder: Path, asked: Asked, workers: int, nodes: int, seed: int, client: bool, rounds: int, failing: float
) -> None:
    """Run and measure; raises `ClickException` where a file differs, or the batch was over before all kills."""
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    on_s3 = asked.to == "s3"
    if on_s3:
        os.environ.update(VARIABLES)
    sweep = write_sweep(folder, asked.scenarios, asked.frames_each, *((S3_LOG, S3_SCENE) if on_s3 else ()))
    results = folder / "results.json"
    figures = json.loads(results.read_bytes()) if results.is_file() else {}
    if figures.get("options") != asdict(asked):
        figures = {"options": asdict(asked)}
    measurement, chance = Measurement(folder, asked, environment(folder), sweep, figures), random.Random(seed)
    measurement.whole()
    kills = ["worker"] * workers + ["node"] * nodes + ["driver"]
    chance.shuffle(kills)
    with ExitStack() as stack:
        if on_s3:
            stack.enter_context(s3_server(folder, failing, seed))
        cluster = Cluster(folder, measurement.variables)
        stack.callback(cluster.end)
        cluster.start(NODES)
        if rounds and "overhead" not in figures:
            measurement.overhead(cluster, rounds)
        shutil.rmtree(folder / "home" / ".cache" / "unisim_blender" / "inputs", ignore_errors=True)  # fetched anew
        address = f"ray://{HEAD}:{CLIENT_PORT}" if client else f"{HEAD}:{PORT}"
        measurement.note(seed=seed, failing=failing if on_s3 else 0.0, client=client)
        measurement.killed(cluster, address, kills, chance)
    shown = {name: value for name, value in figures.items() if name != "options"}
    shown["killed_run"] = {name: value for name, value in shown["killed_run"].items() if name != "kills"}
    click.echo(json.dumps(shown, indent=1))
    killed = figures["killed_run"]
    if killed["differing_files"] or figures.get("overhead", {}).get("differing_files"):
        raise click.ClickException(f"files differ: {', '.join(killed['differing'])}")
    if killed["kills_not_reached"]:
        raise click.ClickException(
            f"the batch was over before {len(killed['kills_not_reached'])} kills; run more units"
        )


@click.command()
@click.option("--folder", type=click.Path(path_type=Path), required=True, help="Where all is written.")
@click.option("--scenarios", type=click.IntRange(min=1), default=100, show_default=True)
@click.option(
    "--frames-each",
    type=click.IntRange(1, 20),
    default=20,
    show_default=True,
    help="Of 20, that no other scenario has.",
)
@click.option("--workers", type=int, default=10, show_default=True, help="So many are killed.")
@click.option("--nodes", type=int, default=2, show_default=True, help="So many are killed.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--client", is_flag=True, help="Join the cluster by Ray's client.")
@click.option("--to", type=click.Choice(["folder", "s3"]), default="folder", show_default=True)
@click.option(
    "--failing", type=click.FloatRange(0, 0.5), default=0.05, show_default=True, help="Of S3's requests, the share."
)
@click.option("--overhead-rounds", type=int, default=0, show_default=True, help="Of processes and Ray without kills.")
def main(
    folder: Path, scenarios: int, frames_each: int, workers: int, nodes: int, seed: int, client: bool, to: str,
    failing: float, overhead_rounds: int,
) -> None:  # fmt: skip
    """Kill workers, nodes and the command of a batch on Ray, and compare its files with those of one process."""
    if to == "s3" and overhead_rounds:
        raise click.UsageError("the overhead is measured in folders: leave out --to s3 or --overhead-rounds")
    if INSIDE not in os.environ:
        command = ["unshare", "--net", sys.executable, "-m", "benchmarks.batch_kills", *sys.argv[1:]]
        raise SystemExit(subprocess.run(command, env=os.environ | {INSIDE: "1"}).returncode)
    folder.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # what was started is ended, too
    asked = Asked(scenarios, frames_each, to, code_identity()["sha256"])
    inside(folder, asked, workers, nodes, seed, client, overhead_rounds, failing)


if __name__ == "__main__":
    main()
