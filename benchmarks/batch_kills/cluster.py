"""A Ray cluster on this machine: a head without cores, and nodes of a core each."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import click

from .processes import CpuMeter, below, end

HEAD = "127.0.0.1"
PORT, CLIENT_PORT = 6379, 10001
START = (
    sys.executable, "-m", "ray.scripts.scripts", "start", "--block", "--disable-usage-stats",
    "--include-log-monitor=false", f"--object-store-memory={100 << 20}",
)  # fmt: skip
AGENT_PORTS = (
    "dashboard-agent-grpc-port", "dashboard-agent-listen-port", "metrics-export-port", "runtime-env-agent-port",
)  # fmt: skip
"""Named, because Ray waits for ports that its agents choose for seconds alone, which a busy machine exceeds."""


def environment(folder: Path) -> dict[str, str]:
    """The environment of all that is run: a home and a token of their own, nothing sent."""
    (folder / "home").mkdir(exist_ok=True)
    given = {name: value for name, value in os.environ.items() if not name.startswith("RAY_")}
    own = {
        "HOME": str((folder / "home").resolve()), "RAY_AUTH_MODE": "token", "RAY_AUTH_TOKEN": secrets.token_hex(32),
        "RAY_USAGE_STATS_ENABLED": "0", "RAY_raylet_start_wait_time_s": "300",
        "RAY_agent_register_timeout_ms": "300000",
    }  # fmt: skip
    return given | own


@dataclass
class Cluster:
    """The head and the nodes are this process's children; `start` starts them, `end` ends them."""

    folder: Path
    variables: Mapping[str, str]
    nodes: list[subprocess.Popen[bytes]] = field(default_factory=list)
    head: subprocess.Popen[bytes] | None = None
    started: int = 0

    def start(self, nodes: int) -> None:
        """Start the head and so many nodes, and wait until they have joined."""
        self.head = self._started(0)
        self._wait(self.head)
        for _ in range(nodes):
            self.add()
            self._wait(self.nodes[-1])

    def cpu(self) -> CpuMeter:
        """Return a meter of the processor time of the head and the nodes."""
        return CpuMeter([*self.nodes, *filter(None, [self.head])])

    def end(self) -> None:
        """End all that runs."""
        for process in [*self.nodes, *filter(None, [self.head])]:
            end(process)

    def add(self) -> None:
        """Start a node."""
        self.nodes.append(self._started(1))

    def replace_ended(self) -> int:
        """Start a node for each that has ended by itself; how many had."""
        gone = [node for node in self.nodes if node.poll() is not None]
        for node in gone:
            self.nodes.remove(node)
            self.add()
        return len(gone)

    def workers(self) -> dict[int, int]:
        """Processes that run a unit, by their ids, with the place of their node."""
        return {
            pid: place
            for place, node in enumerate(self.nodes)
            for pid, title in below(node.pid).items()
            if title.startswith("ray::_Actor.run")
        }

    def kill_worker(self, pid: int) -> None:
        """Kill a process that runs a unit."""
        os.kill(pid, signal.SIGKILL)

    def kill_node(self, place: int) -> None:
        """Kill a node with all its processes, and start another."""
        end(self.nodes.pop(place))
        self.add()

    def _started(self, cores: int) -> subprocess.Popen[bytes]:
        self.started += 1
        temporary = f"--temp-dir={(self.folder / 'ray').resolve()}"
        which = [f"--address={HEAD}:{PORT}", f"--node-ip-address=127.0.0.{self.started}"]
        if cores == 0:
            which = ["--head", f"--node-ip-address={HEAD}", f"--port={PORT}", "--include-dashboard=false", temporary]
        first = 20000 + 10 * self.started
        ports = [f"--{name}={first + number}" for number, name in enumerate(AGENT_PORTS)]
        with self._log().open("wb") as log:
            return subprocess.Popen(
                [*START, *which, *ports, f"--num-cpus={cores}"], env=dict(self.variables), stdout=log, stderr=log,
                start_new_session=True,
            )  # fmt: skip

    def _wait(self, process: subprocess.Popen[bytes]) -> None:
        """Wait until what was started last has joined."""
        while b"Ray runtime started" not in self._log().read_bytes():
            if process.poll() is not None:
                raise click.ClickException(f"a node did not start, see {self._log()}")
            time.sleep(0.2)

    def _log(self) -> Path:
        return self.folder / f"ray-{self.started}.log"
