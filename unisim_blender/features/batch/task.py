"""A batch that runs in the background, or that a cluster runs."""

from __future__ import annotations

import json
from pathlib import Path

from ...process.tasks import Task
from ...translations import message


class BatchTask(Task):
    """Units of a batch, which the command line tells of as they end. ``out`` is the folder or URL that it writes to.

    Cancelled and submitted again, it goes on with the units that are missing.
    """

    hears = True

    def __init__(self, arguments: list[str], folder: Path, out: str, chosen: str) -> None:
        super().__init__(arguments, folder, 0.0, chosen)
        self.out = out
        self.kept = self.finished = self.failed = 0
        """Units that an earlier run had finished, that this one has, and that failed."""

    @property
    def place(self) -> str:
        """The folder or URL of the batch; `folder` has its scenarios."""
        return self.out

    @property
    def done(self) -> float:
        """Units that have ended."""
        return float(self.kept + self.finished + self.failed)

    def hear(self, line: str) -> None:
        """Take what the command line says: how many units there are, and each that ends."""
        try:
            event = json.loads(line)
        except ValueError:
            return  # cut off where the process was ended
        if event["event"] == "start":
            self.total, self.kept = float(event["units"]), event["kept"]
            self.before = self.done
        elif event["event"] == "unit" and event["failure"] is None:
            self.finished += 1
        elif event["event"] == "unit":
            self.failed += 1

    def measure(self) -> str:
        """Units of how many, and how many failed."""
        if not self.total:
            return message("Checking scenarios")
        told = message("{done} of {total} units", done=int(self.done), total=int(self.total))
        return told if not self.failed else message("{units}, {count} failed", units=told, count=self.failed)

    def speed(self, rate: float) -> str:
        """Units a minute."""
        return message(", {rate:.1f} units/min", rate=60 * rate)
