"""The rounds: every process is started once, and in each round every render request is rendered once, one
after the other."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack

from unisim_blender.core.errors import UnisimError

from .cases import BenchmarkCase
from .methods import DEFAULT, ENVIRONMENTS, VARIANTS
from .process import RendererProcess


class MeasuringProcesses:
    """The processes by their names in `methods.ENVIRONMENTS`, started when they are needed. To be closed."""

    def __init__(self) -> None:
        self._stack = ExitStack()
        self._running: dict[str, RendererProcess] = {}

    def __getitem__(self, name: str) -> RendererProcess:
        if name not in self._running:
            self._running[name] = self._stack.enter_context(RendererProcess(ENVIRONMENTS[name]))
        return self._running[name]

    def variants(self) -> dict[str, str]:
        """The instruction set that each process of compiled kernels has: where the processor or the build lacks the one
        that was asked for, another. Raises `UnisimError` where there are no kernels."""
        found = {name: self[name].variant() for name in (DEFAULT, *VARIANTS)}
        if found[DEFAULT] == "torch":
            raise UnisimError(
                "a measurement needs the compiled kernels: run make setup, and leave UNISIM_NATIVE=0 away"
            )
        return found

    def close(self) -> None:
        """End them all."""
        self._stack.close()


def turns(cases: Sequence[BenchmarkCase], rounds: int) -> int:
    """How many requests `measure` renders."""
    return sum(1 if entry.once else rounds for case in cases for entry in case.entries)


def measure(
    cases: Iterable[BenchmarkCase],
    processes: MeasuringProcesses,
    rounds: int,
    begin: Callable[[str], object] = lambda kind: None,
    end: Callable[[], object] = lambda: None,
) -> None:
    """Render every case's requests, interleaved, ``rounds`` times; measurements go to their entries as they come, so
    that an interruption leaves what was measured. ``begin`` is told the case's kind before each render request, ``end``
    is called after it."""
    for case in cases:
        for _ in range(rounds):
            for entry in case.entries:
                if entry.once and entry.measurements:
                    continue
                begin(case.kind)
                if entry.fresh:
                    with RendererProcess(ENVIRONMENTS[entry.process]) as process:
                        entry.measurements.append(process.render(entry.request))
                else:
                    entry.measurements.append(processes[entry.process].render(entry.request))
                end()
