"""A batch on a Ray cluster whose workers, nodes and driver are killed at random: its files beside those of one process.

    python -m benchmarks.batch_kills --folder out/kills
    python -m benchmarks.batch_kills --folder out/kills --scenarios 20 --frames-each 4 --seed 3

The scenarios are of the sample's street: a parked car, turned a little further in each, is there for some frames, so that
images and sweeps of those frames differ in all of them. A head without cores and two nodes of a core each run on this
machine, in a network namespace of its own (`unshare`, root), with Ray's folders and token below ``--folder``. Only
processes that were started here are killed.
"""

from __future__ import annotations

import json
import os
import random
import secrets
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

import click

INSIDE = "UNISIM_KILLS_INSIDE"
BASE = Path("sample/objects.json")
FRAME_S = 0.1
FIRST_FRAME = 5
"""Of those that differ: the car is ahead of the vehicle then."""
HEAD = "127.0.0.1"
PORT = 6379


def write_sweep(folder: Path, scenarios: int, frames_each: int) -> Path:
    """Write a sweep whose variants differ in so many frames each; its path."""
    document = json.loads(BASE.read_text())
    car = {
        "type": "insert", "actor": "car-13", "id": "parked", "pose": {"position": [32.0, 6.2, 0.725], "yaw_deg": 180.0},
        "present": {
            "start_s": FRAME_S * (FIRST_FRAME - 0.4), "end_s": FRAME_S * (FIRST_FRAME + frames_each - 0.6)
        },
    }  # fmt: skip
    if frames_each >= 20:
        del car["present"]
    document |= {
        "name": "kills", "log": os.path.relpath("out/street", folder), "scene": os.path.relpath("sample/scene", folder),
        "edits": [car], "outputs": {"formats": ["png", "labels"], "passes": ["rgb", "depth"]},
    }  # fmt: skip
    (folder / "base.json").write_text(json.dumps(document))
    turned = {"at": "/edits/0/pose/yaw_deg", "range": {"start": 170.0, "stop": 190.0, "count": scenarios}}
    sweep = {
        "format": "unisim-sweep", "version": 1, "name": "kills", "scenario": "base.json",
        "parameters": {"yaw": turned},
    }  # fmt: skip
    (folder / "sweep.json").write_text(json.dumps(sweep))
    return folder / "sweep.json"


def environment(folder: Path) -> dict[str, str]:
    """The environment of Ray's processes: a home and a token of their own, nothing sent."""
    (folder / "home").mkdir(exist_ok=True)
    given = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    own = {
        "HOME": str((folder / "home").resolve()), "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_USAGE_STATS_ENABLED": "0", "RAY_raylet_start_wait_time_s": "300", "RAY_agent_register_timeout_ms": "300000",
    }  # fmt: skip
    return given | own


def below(pid: int) -> dict[int, str]:
    """Names of the processes that descend from one, by their ids."""
    found: dict[int, tuple[int, str]] = {}
    for path in Path("/proc").glob("[0-9]*"):
        try:
            title = (path / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
            found[int(path.name)] = int((path / "stat").read_text().rpartition(")")[2].split()[1]), title
        except OSError:
            continue
    inside, grown = {pid}, True
    while grown:
        more = {one for one, (parent, _) in found.items() if parent in inside} - inside
        inside, grown = inside | more, bool(more)
    return {one: title for one, (_, title) in found.items() if one in inside and one != pid}


@dataclass
class Cluster:
    """A head without cores, and nodes of a core each. The processes are this one's children."""

    folder: Path
    variables: dict[str, str]
    address: str
    nodes: list[subprocess.Popen[bytes]] = field(default_factory=list)
    driver: subprocess.Popen[bytes] | None = None
    started: int = 0

    def start(self, cores: int) -> subprocess.Popen[bytes]:
        """Start the head, for no cores, or a node that joins it."""
        self.started += 1
        ray = [
            sys.executable,
            "-m",
            "ray.scripts.scripts",
            "start",
            "--block",
            "--disable-usage-stats",
            "--include-log-monitor=false",
        ]
        if cores == 0:
            temporary = f"--temp-dir={(self.folder / 'ray').resolve()}"
            which = ["--head", f"--node-ip-address={HEAD}", f"--port={PORT}", "--include-dashboard=false", temporary]
        else:
            which = [f"--address={HEAD}:{PORT}", f"--node-ip-address=127.0.0.{self.started}"]
        store, first = f"--object-store-memory={100 << 20}", 20000 + 10 * self.started
        # named, because Ray waits for ports that its agents choose for seconds alone, which a busy machine exceeds
        named = [
            "dashboard-agent-grpc-port",
            "dashboard-agent-listen-port",
            "metrics-export-port",
            "runtime-env-agent-port",
        ]
        ports = [f"--{name}={first + number}" for number, name in enumerate(named)]
        with (self.folder / f"ray-{self.started}.log").open("wb") as log:
            return subprocess.Popen(
                [*ray, *which, *ports, f"--num-cpus={cores}", store], env=self.variables, stdout=log, stderr=log,
                start_new_session=True,
            )  # fmt: skip

    def add(self) -> None:
        """Start a node."""
        self.nodes.append(self.start(1))

    def wait(self, process: subprocess.Popen[bytes]) -> None:
        """Wait until what was started last has joined."""
        log = self.folder / f"ray-{self.started}.log"
        while b"Ray runtime started" not in log.read_bytes():
            if process.poll() is not None:
                raise click.ClickException(f"a node did not start, see {log}")
            time.sleep(0.2)

    def workers(self) -> dict[int, int]:
        """Processes that run units, by their ids, with the place of their node."""
        return {
            pid: place
            for place, node in enumerate(self.nodes)
            for pid, title in below(node.pid).items()
            if title.startswith("ray::_Actor.run")
        }

    def kill_node(self, place: int) -> None:
        """Kill a node with all its processes, and start another."""
        end(self.nodes.pop(place))
        self.add()


def end(process: subprocess.Popen[bytes]) -> None:
    """Kill a process that was started here and those below it."""
    for pid in [process.pid, *below(process.pid)]:
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            continue
    process.wait()


def batch(sweep: Path, out: Path, *more: str) -> list[str]:
    """The command of a batch."""
    return [
        sys.executable, "-m", "unisim_blender", "batch", str(sweep), "--out", str(out), "--unit", "10", "--width", "240",
        "--quality", "fast", *more,
    ]  # fmt: skip


def digests(folder: Path) -> dict[str, bytes]:
    """All files of a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def finished(out: Path) -> int:
    """How many units have a record."""
    return len(list(out.glob("records/*.json")))


def killed_run(sweep: Path, out: Path, units: int, kills: list[str], chance: random.Random, cluster: Cluster) -> None:
    """Run a batch on the cluster; each of the kills comes when some share of the units is finished."""
    at = sorted(chance.uniform(0.02, 0.95) * units for _ in kills)
    plan = list(zip(at, kills, strict=True))
    command = batch(sweep, out, "--on", cluster.address, "--jobs", "2")
    with (cluster.folder / "driver.log").open("ab") as log:
        cluster.driver = driver = subprocess.Popen(command, env=cluster.variables, stdout=log, stderr=log)
        while driver.poll() is None or plan:
            if driver.poll() is not None:
                raise click.ClickException(f"the batch ended by itself, see {cluster.folder / 'driver.log'}")
            if not plan or finished(out) < plan[0][0]:
                time.sleep(0.1)
                continue
            time.sleep(chance.uniform(0.0, 1.5))
            kind, workers = plan[0][1], cluster.workers()
            if kind != "driver" and not workers:
                continue  # none is at work yet since the last kill
            plan.pop(0)
            click.echo(f"{time.strftime('%H:%M:%S')} {finished(out)} of {units} units: {kind} killed", err=True)
            if kind == "worker":
                os.kill(chance.choice(sorted(workers)), signal.SIGKILL)
            elif kind == "node":
                cluster.kill_node(chance.choice(sorted(set(workers.values()))))
            else:
                driver.kill()
                driver.wait()
                driver = subprocess.Popen([*command, "--resume"], env=cluster.variables, stdout=log, stderr=log)
                cluster.driver = driver
        if driver.returncode != 0:  # a unit that was met three times has failed; resuming repeats it
            click.echo("resumed once more: a unit was met three times", err=True)
            driver = cluster.driver = subprocess.Popen(
                [*command, "--resume"], env=cluster.variables, stdout=log, stderr=log
            )
        if driver.wait() != 0:
            raise click.ClickException(f"the batch failed, see {cluster.folder / 'driver.log'}")


def inside(folder: Path, scenarios: int, frames_each: int, workers: int, nodes: int, seed: int, client: bool) -> None:
    """Run both batches and compare their files."""
    subprocess.run(["ip", "link", "set", "lo", "up"], check=True)
    sweep, chance = write_sweep(folder, scenarios, frames_each), random.Random(seed)
    variables = environment(folder)
    began = time.monotonic()
    if not (folder / "whole" / "manifest.json").is_file():
        subprocess.run(batch(sweep, folder / "whole", "--on", "this-process"), check=True, env=variables)
        click.echo(f"in one process: {time.monotonic() - began:.0f} s")
    counts = json.loads((folder / "whole" / "manifest.json").read_bytes())["counts"]
    kills = ["worker"] * workers + ["node"] * nodes + ["driver"]
    chance.shuffle(kills)
    cluster = Cluster(folder, variables, f"ray://{HEAD}:10001" if client else f"{HEAD}:{PORT}")
    shutil.rmtree(folder / "killed", ignore_errors=True)
    began, head = time.monotonic(), cluster.start(0)
    try:
        cluster.wait(head)
        for _ in range(2):
            cluster.add()
            cluster.wait(cluster.nodes[-1])
        killed_run(sweep, folder / "killed", counts["units"], kills, chance, cluster)
    finally:
        for process in filter(None, [cluster.driver, *cluster.nodes, head]):
            end(process)
    expected, found = digests(folder / "whole"), digests(folder / "killed")
    differ = [name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name)]
    click.echo(
        f"{scenarios} scenarios, {counts['asked']} captures asked for, {counts['rendered']} rendered, {counts['units']} units; "
        f"killed: {workers} workers, {nodes} nodes, the driver; {time.monotonic() - began:.0f} s"
    )
    click.echo(f"{len(expected)} files, {len(differ)} of them differ")
    if differ:
        raise click.ClickException(", ".join(sorted(differ)[:10]))


@click.command()
@click.option("--folder", type=click.Path(path_type=Path), required=True, help="Where all is written.")
@click.option("--scenarios", type=int, default=100, show_default=True)
@click.option("--frames-each", type=int, default=20, show_default=True, help="Frames of each that no other has, of 20.")
@click.option("--workers", type=int, default=10, show_default=True, help="So many are killed.")
@click.option("--nodes", type=int, default=2, show_default=True, help="So many are killed.")
@click.option("--seed", type=int, default=0, show_default=True)
@click.option("--client", is_flag=True, help="Join the cluster by Ray's client.")
def main(folder: Path, scenarios: int, frames_each: int, workers: int, nodes: int, seed: int, client: bool) -> None:
    """Kill workers, nodes and the driver of a batch on Ray, and compare its files with those of one process."""
    if INSIDE not in os.environ:
        command = ["unshare", "--net", sys.executable, "-m", "benchmarks.batch_kills", *sys.argv[1:]]
        raise SystemExit(subprocess.run(command, env=os.environ | {INSIDE: "1"}).returncode)
    folder.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # what was started is ended, too
    inside(folder, scenarios, frames_each, workers, nodes, seed, client)


if __name__ == "__main__":
    main()
