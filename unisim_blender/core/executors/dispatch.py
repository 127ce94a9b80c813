"""Hand units to workers that come and go: each holds a scene, and one that is lost is replaced."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Generic, Protocol, TypeVar

from .executor import MOST_LOSSES, OnWorker, Outcome, Outcomes, ProcessLost, WorkerState, ignore


class SceneQueue:
    """Indices of waiting units, by scene, in the order in which they were given, and how often the worker of each was lost."""

    def __init__(self, scenes: Sequence[str]) -> None:
        self._scenes = scenes
        self._losses = [0] * len(scenes)
        self._waiting: dict[str, deque[int]] = {}
        for index, scene in enumerate(scenes):
            self._waiting.setdefault(scene, deque()).append(index)

    def take(self, held: str | None, others: Sequence[str | None] = ()) -> int | None:
        """Return the next unit for a worker that holds a scene; ``others`` are held by other workers. None where no
        unit waits.

        Where none of the held scene waits, it is of the scene with the most waiting units for each worker that holds it.
        """
        waiting = {scene: units for scene, units in self._waiting.items() if units}
        if not waiting:
            return None
        if held not in waiting:
            held = max(waiting, key=lambda scene: len(waiting[scene]) / (1 + list(others).count(scene)))
        return waiting[held].popleft()

    def lost(self, index: int) -> Outcome[None] | None:
        """Have a unit whose worker was lost wait again, before the others of its scene. Where that was the last time, its outcome
        is returned."""
        self._losses[index] += 1
        if self._losses[index] < MOST_LOSSES:
            self._waiting[self._scenes[index]].appendleft(index)
            return None
        return Outcome(
            index, error=ProcessLost(f"its process was ended from outside {MOST_LOSSES} times (out of memory?)")
        )


def scenes_or_one(scenes: Sequence[str] | None, units: int) -> Sequence[str]:
    """Return the scenes of so many units: one for all, where none are given."""
    return [""] * units if scenes is None else scenes


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
    """State of a worker: ``index`` is that of its unit, None where no unit waits."""

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
