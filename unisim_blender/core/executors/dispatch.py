"""Dispatch of units to workers that each hold a scene; lost workers are replaced. The executors of this
machine: units one after another in this process, or in several processes of one thread each.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection, wait
from multiprocessing.context import SpawnProcess
from typing import Any, Generic, Protocol, TypeVar

from ..processes import THREAD_VARIABLES, WORKER_VARIABLE, end_with_parent
from .executor import (
    MAX_LOSSES,
    MakeFunction,
    OnWorker,
    Outcome,
    Outcomes,
    ProcessLost,
    ResultT,
    UnitT,
    WorkerState,
    attempt,
    ignore,
    register,
)


class SceneQueue:
    """Indices of waiting units, by scene, in the order in which they were given, and how often the worker of each was lost."""

    def __init__(self, scenes: Sequence[str]) -> None:
        self._scenes = scenes
        self._losses = [0] * len(scenes)
        self._waiting: dict[str, deque[int]] = {}
        for index, scene in enumerate(scenes):
            self._waiting.setdefault(scene, deque()).append(index)

    def take(self, loaded: str | None, others: Sequence[str | None] = ()) -> int | None:
        """Return the next unit for a worker that holds a scene; ``others`` are held by other workers. None where no
        unit waits.

        Where none of the held scene waits, it is of the scene with the most waiting units for each worker that holds it.
        """
        waiting = {scene: units for scene, units in self._waiting.items() if units}
        if not waiting:
            return None
        if loaded not in waiting:
            loaded = max(waiting, key=lambda scene: len(waiting[scene]) / (1 + list(others).count(scene)))
        return waiting[loaded].popleft()

    def lost(self, index: int) -> Outcome[None] | None:
        """Have a unit whose worker was lost wait again, before the others of its scene. Where that was the last time, its outcome
        is returned."""
        self._losses[index] += 1
        if self._losses[index] < MAX_LOSSES:
            self._waiting[self._scenes[index]].appendleft(index)
            return None
        return Outcome(
            index, error=ProcessLost(f"its process was ended from outside {MAX_LOSSES} times (out of memory?)")
        )


def scene_of_each_unit(scenes: Sequence[str] | None, units: int) -> Sequence[str]:
    """Return the scenes of so many units: one for all, where none are given."""
    return [""] * units if scenes is None else scenes


WorkerT = TypeVar("WorkerT")

PREPARING = -1
"""The index of a worker's first outcome: its function is made."""


class Pool(Protocol[WorkerT]):
    """Workers as `dispatch` sees them."""

    def start(self, number: int) -> WorkerT:
        """Start a worker of this number; its first outcome has the index `PREPARING`."""

    def send(self, worker: WorkerT, index: int, unit: Any) -> None:
        """Give a worker a unit. One that is gone is told by `finished`."""

    def finished(self, busy: Sequence[WorkerT]) -> Iterable[tuple[WorkerT, Outcome[Any] | None]]:
        """Wait, and return the workers that have an outcome; None of one that is lost."""

    def end(self, worker: WorkerT) -> None:
        """End a worker at once, and wait until it is gone."""


def dispatch(
    pool: Pool[WorkerT], units: Sequence[Any], jobs: int, scenes: Sequence[str], on_worker: OnWorker = ignore
) -> Outcomes[Any]:
    """Yield the outcome of each unit, run by at most ``jobs`` workers. Raises what making the function raises, and
    `ProcessLost` where one worker after another is lost before it is made."""
    workers = _Workers(pool, units, scenes, on_worker)
    lost_unmade, remaining = 0, len(units)
    try:
        for number in range(min(jobs, len(units))):
            workers.start(number)
        while remaining:  # workers that never find room do not hold the others up
            for worker, outcome in pool.finished(workers.busy()):
                index = workers.index_of(worker)
                if outcome is None:
                    lost_unmade += index == PREPARING
                    if lost_unmade == MAX_LOSSES:
                        raise ProcessLost(f"{lost_unmade} processes were ended from outside as they started")
                    outcome = workers.replace(worker)
                else:
                    if index == PREPARING:
                        outcome.get()
                        outcome, lost_unmade = None, 0
                    workers.feed(worker)
                if outcome is not None:
                    remaining -= 1
                    yield outcome
    finally:
        workers.end()


@dataclass
class _State:
    """State of a worker: ``index`` is that of its unit, None where no unit waits."""

    number: int
    index: int | None = PREPARING
    scene: str | None = None


@dataclass
class _Workers(Generic[WorkerT]):
    """The workers of a run, with what each is at, and the units that wait."""

    pool: Pool[WorkerT]
    units: Sequence[Any]
    scenes: Sequence[str]
    on_worker: OnWorker
    states: dict[WorkerT, _State] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.queue = SceneQueue(self.scenes)

    def start(self, number: int) -> None:
        self.states[self.pool.start(number)] = _State(number)
        self.on_worker(WorkerState(number, "starting"))

    def busy(self) -> list[WorkerT]:
        """Return the workers that an outcome will come of."""
        return [worker for worker, state in self.states.items() if state.index is not None]

    def index_of(self, worker: WorkerT) -> int:
        """Return the index of what a busy worker is at."""
        index = self.states[worker].index
        assert index is not None
        return index

    def feed(self, worker: WorkerT) -> None:
        """Give a worker its next unit, if one waits."""
        state = self.states[worker]
        state.index = self.queue.take(
            state.scene, [other.scene for other in self.states.values() if other is not state]
        )
        if state.index is None:
            self.on_worker(WorkerState(state.number, "idle"))
            return
        loads, state.scene = state.scene != self.scenes[state.index], self.scenes[state.index]
        self.pool.send(worker, state.index, self.units[state.index])
        self.on_worker(WorkerState(state.number, "unit", state.index, loads))

    def replace(self, worker: WorkerT) -> Outcome[None] | None:
        """Start another worker in place of a lost one, whose unit waits again; the unit's outcome where it has failed."""
        self.pool.end(worker)
        state = self.states.pop(worker)
        self.on_worker(WorkerState(state.number, "lost", None if state.index == PREPARING else state.index))
        self.start(state.number)
        return None if state.index in (None, PREPARING) else self.queue.lost(state.index)

    def end(self) -> None:
        for worker in self.states:
            self.pool.end(worker)


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
        if not units:
            return
        on_worker(WorkerState(0, "starting"))
        scenes = scene_of_each_unit(scenes, len(units))
        function, queue, loaded = make(), SceneQueue(scenes), None
        while (index := queue.take(loaded)) is not None:
            loads, loaded = loaded != scenes[index], scenes[index]
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
        yield from dispatch(
            _Pool(make), units, jobs or os.cpu_count() or 1, scene_of_each_unit(scenes, len(units)), on_worker
        )


register("processes", Processes())


@dataclass(frozen=True, eq=False)
class _Worker:
    process: SpawnProcess
    connection: Connection


@dataclass(frozen=True)
class _Pool:
    make: MakeFunction[Any, Any]

    def start(self, number: int) -> _Worker:
        context = multiprocessing.get_context("spawn")  # a forked child would keep the parent's threads' locks
        own, theirs = context.Pipe()
        process = context.Process(target=_serve, args=(theirs, self.make, number), daemon=True)
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


def _serve(connection: Connection, make: MakeFunction[Any, Any], number: int) -> None:
    """Make the function and run the units that come, until nobody sends any."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    end_with_parent()
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"  # for libraries that are imported from here on
    os.environ[WORKER_VARIABLE] = str(number)
    prepared = attempt(PREPARING, make)
    connection.send(Outcome(PREPARING, error=prepared.error, details=prepared.details))
    while prepared.result is not None:
        try:
            index, unit = connection.recv()
        except EOFError:
            return
        connection.send(attempt(index, prepared.result, unit))
