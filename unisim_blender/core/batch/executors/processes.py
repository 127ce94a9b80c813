"""Units in several processes of this machine, of one thread each."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess

from ...processes import THREAD_VARIABLES, end_with_parent
from .executor import HasScene, MakeRun, Outcome, attempt, register
from .queue import SceneQueue

MOST_LOSSES = 3
"""A unit whose process was ended from outside so many times has failed."""


@dataclass
class _Worker:
    process: SpawnProcess
    connection: Connection
    index: int | None = None
    scene: str | None = None


class Processes:
    """Runs units in ``jobs`` processes, fewer where there are fewer units. One that is ended from outside is replaced, and its
    unit run again. All end with the caller, in the middle of their units where it stops early or is killed."""

    def run(self, make: MakeRun, units: Sequence[HasScene], jobs: int) -> Iterator[Outcome]:
        """See `BatchExecutor.run`."""
        queue, losses = SceneQueue(units), [0] * len(units)
        workers = [_started(make) for _ in range(min(jobs, len(units)))]
        try:
            for worker in workers:
                _feed(worker, workers, queue, units)
            while busy := [worker for worker in workers if worker.index is not None]:
                ready = wait([worker.connection for worker in busy])
                for worker in [one for one in busy if one.connection in ready]:
                    index = worker.index
                    assert index is not None
                    try:
                        outcome: Outcome | None = worker.connection.recv()
                    except (EOFError, OSError):
                        outcome = None
                    if outcome is None:
                        _end(worker)
                        replacement = _started(make)
                        workers[workers.index(worker)] = replacement
                        losses[index] += 1
                        if losses[index] < MOST_LOSSES:
                            queue.put_back(index)
                        else:
                            lost = f"its process was ended from outside {MOST_LOSSES} times (out of memory?)"
                            outcome = Outcome(index, failure=lost)
                        worker = replacement
                    worker.index = None
                    _feed(worker, workers, queue, units)
                    if outcome is not None:
                        yield outcome
        finally:
            for worker in workers:
                _end(worker)


register("processes", Processes())


def _started(make: MakeRun) -> _Worker:
    context = multiprocessing.get_context("spawn")  # a forked child would keep the parent's threads' locks
    own, theirs = context.Pipe()
    process = context.Process(target=_serve, args=(theirs, make), daemon=True)
    process.start()
    theirs.close()
    return _Worker(process, own)


def _feed(worker: _Worker, workers: Sequence[_Worker], queue: SceneQueue, units: Sequence[HasScene]) -> None:
    """Give a worker its next unit, if one waits."""
    index = queue.take(worker.scene, [one.scene for one in workers if one is not worker])
    if index is None:
        return
    worker.index, worker.scene = index, units[index].scene
    try:
        worker.connection.send((index, units[index]))
    except OSError:
        return  # it is gone: reading from it tells


def _end(worker: _Worker) -> None:
    worker.connection.close()
    worker.process.kill()
    worker.process.join()


def _serve(connection: Connection, make: MakeRun) -> None:
    """Run the units that come, until nobody sends any."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    end_with_parent()
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"  # for libraries that are imported from here on
    run = make()
    while True:
        try:
            index, unit = connection.recv()
        except EOFError:
            return
        connection.send(attempt(run, index, unit))
