"""How far a batch is, while it runs: a live table in a terminal, a line now and then elsewhere."""

from __future__ import annotations

import sys
import time
from collections import deque
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any

from ...batch.status import clock_text, seconds_left
from ...progress import Bar

if TYPE_CHECKING:
    from ...batch.plan import Unit
    from ...batch.run import Failure
    from ...executors.executor import WorkerState
    from ...render.tracers.surfels.build import Step

LAST_FAILURES = 5
MOST_WORKERS = 16
"""Largest number of workers shown below the table."""


@dataclass
class WorkerRow:
    """State of a worker: its activity since a time of the monotonic clock, how many units it has begun, and how often
    it was lost."""

    doing: str = ""
    since_s: float = 0.0
    begun: int = 0
    lost: int = 0


class BatchProgress:
    """Counts of units and captures, for ``total`` units. Use it in a ``with``."""

    def __init__(self, total: int) -> None:
        self.total = total
        self.kept = self.finished = self.failed = self.captures = 0
        self.step = ""
        self.begun = False
        """Whether it is known what an earlier run had finished."""
        self.workers: dict[int, WorkerRow] = {}
        self.failures: deque[Failure] = deque(maxlen=LAST_FAILURES)
        self._times_s: list[float] = [time.monotonic()]
        self._bar: Bar | None = None
        self._live: Any = None

    def __enter__(self) -> BatchProgress:
        if sys.stderr.isatty():
            try:
                from rich.console import Console
                from rich.live import Live
            except ImportError:
                pass  # it is of the extra `batch`
            else:
                self._live = Live(get_renderable=self.table, console=Console(stderr=True), refresh_per_second=2)
                self._live.start()
                return self
        self._bar = Bar(total=self.total, unit="unit", dynamic_ncols=True, smoothing=0.1)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._live is not None:
            self._live.stop()
        if self._bar is not None:
            self._bar.close()

    @property
    def seconds(self) -> float:
        """Time since it was begun."""
        return time.monotonic() - self._times_s[0]

    @property
    def left(self) -> int:
        """Units that are neither finished nor failed."""
        return max(0, self.total - self.kept - self.finished - self.failed)

    @property
    def rate(self) -> float:
        return self.captures / max(self.seconds, 1e-9)

    def on_kept(self, count: int) -> None:
        """Count units that an earlier run had finished."""
        self.begun = True
        self.kept += count
        if self._bar is not None:
            self._bar.update(count)

    def on_step(self, step: Step) -> None:
        """Show what is made of a scene before its units."""
        self.step = "" if step.share == 1 else step.text
        if self._bar is not None:
            self._bar.set_description_str(self.step)

    def on_unit(self, unit: Unit, failure: Failure | None) -> None:
        """Count a unit that has ended."""
        self._times_s.append(time.monotonic())
        if failure is None:
            self.finished += 1
            self.captures += unit.captures
        else:
            self.failed += 1
            self.failures.append(failure)
        if self._bar is not None:
            self._bar.set_postfix_str(f"{self.rate:.1f} captures/s, {self.failed} failed", refresh=False)
            self._bar.update()

    def on_worker(self, state: WorkerState, unit: Unit | None) -> None:
        """Note what a worker does from now on, at this unit."""
        row = self.workers.setdefault(state.number, WorkerRow())
        row.doing, row.since_s = state.doing, time.monotonic()
        if state.doing == "unit" and unit is not None:
            row.begun += 1
            row.doing = f"{unit.variant}, unit {unit.name}" + (
                ", after its scene is loaded" if state.loads_scene else ""
            )
        row.lost += state.doing == "lost"

    def table(self) -> Any:
        """Return the table that a terminal shows."""
        from rich.console import Group
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        cells = {
            "units": str(self.total),
            "kept": str(self.kept),
            "finished": str(self.finished),
            "failed": str(self.failed),
            "left": str(self.left),
            "captures/s": f"{self.rate:.1f}",
            "time": clock_text(self.seconds),
            "time left": clock_text(seconds_left(self._times_s, self.left, time.monotonic())),
        }
        counts = Table(caption=self.step or None, caption_justify="left")
        for name in cells:
            counts.add_column(name, justify="right", style="red" if name == "failed" and self.failed else "")
        counts.add_row(*cells.values())
        bar = Table.grid()  # a bar alone does not end its line
        bar.add_row(ProgressBar(total=max(self.total, 1), completed=self.total - self.left, width=60))
        texts = [f"{failure.variant}, unit {failure.unit}: {failure.reason}" for failure in self.failures]
        failures = [Text(text, style="red", overflow="ellipsis", no_wrap=True) for text in texts]
        return Group(counts, bar, *([self._workers()] if self.workers else []), *failures)

    def _workers(self) -> Any:
        """Return the table of what each worker does."""
        from rich.table import Table
        from rich.text import Text

        more = len(self.workers) - MOST_WORKERS
        table = Table(caption=f"and {more} more" if more > 0 else None, caption_justify="left")
        for name in ("worker", "does", "for", "units begun", "lost"):
            table.add_column(name, justify="left" if name == "does" else "right", no_wrap=True)
        for number, row in sorted(self.workers.items())[:MOST_WORKERS]:
            time_text = clock_text(time.monotonic() - row.since_s)
            table.add_row(str(number), Text(row.doing), time_text, str(row.begun), str(row.lost))
        return table
