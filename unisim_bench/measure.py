"""The rounds of a measurement and its processes: each is started once, and in each round every render request is rendered once,
one after the other.

Kernels are chosen when a process loads them, so each choice has a process of its own.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.processes import end_with_parent, wait_briefly

from .cases import BenchmarkCase
from .render_request import Measurement, RenderRequest, RenderSession
from .settings import DEFAULT, ENVIRONMENTS, VARIANTS

ABOUT = "about"


class RendererProcess:
    """A process with an environment. It does one thing at a time, when it is asked to, and waits otherwise."""

    def __init__(self, environment: dict[str, str]) -> None:
        context = multiprocessing.get_context("spawn")
        self._connection, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, environment), daemon=True)
        self._process.start()
        theirs.close()

    def variant(self) -> str:
        """The instruction set of its kernels; "torch" where it has none."""
        return str(self._ask(ABOUT))

    def render(self, request: RenderRequest) -> Measurement:
        """Render there. Raises what was raised there, and `UnisimError` where the process ended."""
        measurement = self._ask(request)
        assert isinstance(measurement, Measurement)
        return measurement

    def _ask(self, what: Any) -> Any:
        try:
            self._connection.send(what)
            answer = self._connection.recv()
        except (EOFError, OSError) as fault:
            self._process.join(1)
            raise UnisimError(f"a process that rendered has ended, with exit code {self._process.exitcode}") from fault
        if isinstance(answer, Exception):
            raise answer
        return answer

    def __enter__(self) -> RendererProcess:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, fault: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End it, whatever it does: kernels do not listen."""
        self._connection.close()
        self._process.terminate()
        self._process.join()


def _serve(connection: Connection, environment: dict[str, str]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ.update(environment)
    wait_briefly()
    end_with_parent()
    session = RenderSession()
    while True:
        try:
            asked = connection.recv()
        except EOFError:
            return
        try:
            connection.send(_variant() if asked == ABOUT else session.render(asked))
        except Exception as fault:
            connection.send(fault)


def _variant() -> str:
    from unisim_blender.core.native import variant

    return variant()


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
        variants = {name: self[name].variant() for name in (DEFAULT, *VARIANTS)}
        if variants[DEFAULT] == "torch":
            raise UnisimError(
                "a measurement needs the compiled kernels: run make setup, and leave UNISIM_NATIVE=0 away"
            )
        return variants

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
