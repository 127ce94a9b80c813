"""Hand units to workers that come and go: each holds a scene, and one that is lost is replaced."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from .executor import MOST_LOSSES, Outcome, Outcomes, ProcessLost
from .queue import SceneQueue
from .worker_state import OnWorker, WorkerState, ignore

WorkerT = TypeVar("WorkerT")

MAKING = -1
"""The index of a worker's first outcome: its function is made."""


class Pool(Protocol[WorkerT]):
    """Workers as `dispatch` sees them."""

    def start(self) -> WorkerT:
        """Start a worker; its first outcome has the index `MAKING`."""
        ...

    def send(self, worker: WorkerT, index: int, unit: Any) -> None:
        """Give a worker a unit. One that is gone is told by `finished`."""
        ...

    def finished(self, busy: Sequence[WorkerT]) -> Iterable[tuple[WorkerT, Outcome[Any] | None]]:
        """Wait, and return the workers that have an outcome; None of one that is lost."""
        ...

    def end(self, worker: WorkerT) -> None:
        """End a worker at once, and wait until it is gone."""
        ...


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
                    lost_unmade += index == MAKING
                    if lost_unmade == MOST_LOSSES:
                        raise ProcessLost(f"{lost_unmade} processes were ended from outside as they started")
                    outcome = workers.replace(worker)
                else:
                    if index == MAKING:
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
    """What a worker is at: ``index`` is None where nothing waits."""

    number: int
    index: int | None = MAKING
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
        """Start a worker of this number."""
        self.states[self.pool.start()] = _State(number)
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
        state.index = self.queue.take(state.scene, [one.scene for one in self.states.values() if one is not state])
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
        self.on_worker(WorkerState(state.number, "lost", None if state.index == MAKING else state.index))
        self.start(state.number)
        return None if state.index in (None, MAKING) else self.queue.lost(state.index)

    def end(self) -> None:
        """End all workers."""
        for worker in self.states:
            self.pool.end(worker)
