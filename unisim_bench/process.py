"""A process that renders for a measurement: kernels are chosen when a process loads them, so each choice
has one of its own."""

from __future__ import annotations

import multiprocessing
import os
import signal
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.processes import end_with_parent, wait_briefly

from .render_request import Measurement, RenderRequest, RenderSession

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
