"""Executors on this machine: units one after another in this process, or in several processes of one thread each."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any

from ..processes import THREAD_VARIABLES, end_with_parent
from .dispatch import MAKING, SceneQueue, dispatch, scenes_or_one
from .executor import MakeFunction, OnWorker, Outcome, Outcomes, ResultT, UnitT, WorkerState, attempt, ignore, register


class ThisProcess:
    """Runs units scene by scene; ``jobs`` has no effect."""

    def run(
        self,
        make: MakeFunction[UnitT, ResultT],
        units: Sequence[UnitT],
        jobs: int | None = None,
        scenes: Sequence[str] | None = None,
        on_worker: OnWorker = ignore,
    ) -> Outcomes[ResultT]:
        """See `Executor.run`."""
        if not units:
            return
        on_worker(WorkerState(0, "starting"))
        scenes = scenes_or_one(scenes, len(units))
        function, queue, held = make(), SceneQueue(scenes), None
        while (index := queue.take(held)) is not None:
            loads, held = held != scenes[index], scenes[index]
            on_worker(WorkerState(0, "unit", index, loads))
            yield attempt(index, function, units[index])
        on_worker(WorkerState(0, "idle"))


register("this-process", ThisProcess())


class Processes:
    """Runs units in ``jobs`` processes, fewer where there are fewer units. One that is ended from outside is replaced, and its
    unit run again. All end with the caller, in the middle of their units where it stops early or is killed."""

    def run(
        self,
        make: MakeFunction[UnitT, ResultT],
        units: Sequence[UnitT],
        jobs: int | None = None,
        scenes: Sequence[str] | None = None,
        on_worker: OnWorker = ignore,
    ) -> Outcomes[ResultT]:
        """See `Executor.run`."""
        yield from dispatch(
            _Pool(make), units, jobs or os.cpu_count() or 1, scenes_or_one(scenes, len(units)), on_worker
        )


register("processes", Processes())


@dataclass(frozen=True, eq=False)
class _Worker:
    process: SpawnProcess
    connection: Connection


@dataclass(frozen=True)
class _Pool:
    make: MakeFunction[Any, Any]

    def start(self) -> _Worker:
        context = multiprocessing.get_context("spawn")  # a forked child would keep the parent's threads' locks
        own, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self.make), daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, own)

    def send(self, worker: _Worker, index: int, unit: Any) -> None:
        try:
            worker.connection.send((index, unit))
        except OSError:
            return  # it is gone: reading from it tells

    def finished(self, busy: Sequence[_Worker]) -> Iterator[tuple[_Worker, Outcome[Any] | None]]:
        by_connection = {worker.connection: worker for worker in busy}
        for connection in wait(list(by_connection)):
            worker = by_connection[connection]  # type: ignore[index]  # they are those that were given
            try:
                yield worker, worker.connection.recv()
            except (EOFError, OSError):
                yield worker, None

    def end(self, worker: _Worker) -> None:
        worker.connection.close()
        worker.process.kill()
        worker.process.join()


def _serve(connection: Connection, make: MakeFunction[Any, Any]) -> None:
    """Make the function and run the units that come, until nobody sends any."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    end_with_parent()
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"  # for libraries that are imported from here on
    made = attempt(MAKING, make)
    connection.send(Outcome(MAKING, error=made.error, details=made.details))
    while made.result is not None:
        try:
            index, unit = connection.recv()
        except EOFError:
            return
        connection.send(attempt(index, made.result, unit))
