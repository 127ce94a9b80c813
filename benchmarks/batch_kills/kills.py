"""A batch on a cluster, of which workers, nodes and the command are killed at random while it runs."""

from __future__ import annotations

import json
import random
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

import click

from unisim_blender.core.batch.records import RECORDS, Store

from .cluster import Cluster
from .processes import end

FIRST, LAST = 0.02, 0.85
"""Kills come when a share of the units between these is finished."""
LONGEST_WAIT_S = 1.5
"""And up to so much later, in the middle of a unit."""
TOLD_EVERY_S = 30.0
MOST_FAILED_RUNS = 3
"""Runs that end with failed units, because a unit was met three times, before the batch is given up."""


@dataclass
class KilledRun:
    """Runs the command of a batch of so many ``units`` on the cluster until it succeeds; ``kills`` are the kinds of
    what is killed, in their order: "worker", "node" or "driver"."""

    cluster: Cluster
    command: Sequence[str]
    store: Store
    units: int
    kills: Sequence[str]
    chance: random.Random
    poll_s: float = 0.2
    happened: list[dict[str, Any]] = field(default_factory=list)
    resumed: int = 0
    nodes_ended: int = 0
    _driver: subprocess.Popen[bytes] | None = None

    def run(self) -> dict[str, Any]:
        """Run it to its end; what happened, as a JSON object. Raises `ClickException` where the batch fails."""
        at = sorted(self.chance.uniform(FIRST, LAST) * self.units for _ in self.kills)
        plan, failed_runs, began, told = list(zip(at, self.kills, strict=True)), 0, time.monotonic(), time.monotonic()
        log_path = self.cluster.folder / "driver.log"
        with log_path.open("wb") as log:
            try:
                self._start(log)
                while True:
                    assert self._driver is not None
                    code = self._driver.poll()
                    if code == 0:
                        break
                    if code is not None:  # a unit that was met three times has failed; resuming repeats it
                        failed_runs += 1
                        if failed_runs > MOST_FAILED_RUNS:
                            raise click.ClickException(f"the batch failed, see {log_path}")
                        self._tell("the command ended with failures and is resumed")
                        self._start(log)
                    self.nodes_ended += self.cluster.replace_ended()
                    if time.monotonic() - told > TOLD_EVERY_S:
                        told = time.monotonic()
                        self._tell("")
                    if plan and self._finished() >= plan[0][0]:
                        time.sleep(self.chance.uniform(0.0, LONGEST_WAIT_S))
                        if self._kill(plan[0][1], log):
                            plan.pop(0)
                    time.sleep(self.poll_s)
            finally:
                if self._driver is not None:
                    end(self._driver)
        return {
            "seconds": round(time.monotonic() - began, 1),
            "killed": {kind: sum(one["kind"] == kind for one in self.happened) for kind in sorted(set(self.kills))},
            "kills_not_reached": [kind for _, kind in plan],
            "resumed_runs": self.resumed,
            "runs_with_failed_units": failed_runs,
            "nodes_that_ended_by_themselves": self.nodes_ended,
            "kills": self.happened,
        }

    def _kill(self, kind: str, log: IO[bytes]) -> bool:
        """Kill one of a kind; whether there was one at work since the last kill."""
        workers = self.cluster.workers()
        assert self._driver is not None
        if self._driver.poll() is not None or (kind != "driver" and not workers):
            return False
        finished = self._finished()
        if kind == "worker":
            self.cluster.kill_worker(self.chance.choice(sorted(workers)))
        elif kind == "node":
            self.cluster.kill_node(self.chance.choice(sorted(set(workers.values()))))
        else:
            end(self._driver)
            self._start(log)
        self.happened.append({"kind": kind, "finished_units": finished})
        self._tell(f"{kind} killed")
        return True

    def _start(self, log: IO[bytes]) -> None:
        """Start the command, or start it again to resume."""
        again = ["--resume"] if self._driver is not None else []
        self.resumed += len(again)
        self._driver = subprocess.Popen(
            [*self.command, *again], env=dict(self.cluster.variables), stdout=log, stderr=log
        )

    def _finished(self) -> int:
        return len(self.store.sizes(RECORDS))

    def _tell(self, what: str) -> None:
        click.echo(f"{time.strftime('%H:%M:%S')} {self._finished()} of {self.units} units {what}".rstrip(), err=True)


def run_alone(command: Sequence[str], variables: dict[str, str], log: Path) -> dict[str, Any]:
    """Run a batch that nothing is killed of, whose lines go to ``log``; its report. Raises `ClickException`."""
    with log.open("wb") as lines:
        code = subprocess.run(list(command), env=variables, stdout=lines).returncode
    if code != 0:
        raise click.ClickException(f"the batch failed, see {log}")
    report: dict[str, Any] = json.loads(log.read_bytes().splitlines()[-1])
    return report
