"""Hand units to workers that come and go: each holds a scene, and one that is lost is replaced."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from .executor import MOST_LOSSES, Outcome, Outcomes, ProcessLost
from .queue import SceneQueue

Worker = TypeVar("Worker")

MAKING = -1
"""The index of a worker's first outcome: its function is made."""


class Pool(Protocol[Worker]):
    """Workers as `dispatch` sees them."""

    def start(self) -> Worker:
        """Start a worker; its first outcome has the index `MAKING`."""
        ...

    def send(self, worker: Worker, index: int, unit: Any) -> None:
        """Give a worker a unit. One that is gone is told by `finished`."""
        ...

    def finished(self, busy: Sequence[Worker]) -> Iterable[tuple[Worker, Outcome[Any] | None]]:
        """Wait, and return the workers that have an outcome; None of one that is lost."""
        ...

    def end(self, worker: Worker) -> None:
        """End a worker at once, and wait until it is gone."""
        ...


@dataclass
class _State:
    """What a worker is at: ``index`` is None where nothing waits."""

    index: int | None = MAKING
    scene: str | None = None


def dispatch(pool: Pool[Worker], units: Sequence[Any], jobs: int, scenes: Sequence[str]) -> Outcomes[Any]:
    """Yield the outcome of each unit, run by at most ``jobs`` workers. Raises what making the function raises, and `ProcessLost`
    where one worker after another is lost before it is made."""
    queue, lost_unmade, remaining = SceneQueue(scenes), 0, len(units)
    states: dict[Worker, _State] = {pool.start(): _State() for _ in range(min(jobs, len(units)))}
    try:
        while remaining:  # workers that never find room do not hold the others up
            busy = [worker for worker, state in states.items() if state.index is not None]
            for worker, outcome in pool.finished(busy):
                index = states[worker].index
                assert index is not None
                if outcome is None:
                    lost_unmade += index == MAKING
                    if lost_unmade == MOST_LOSSES:
                        raise ProcessLost(f"{lost_unmade} processes were ended from outside as they started")
                    pool.end(worker)
                    del states[worker]
                    states[pool.start()] = _State()
                    outcome = None if index == MAKING else queue.lost(index)
                else:
                    if index == MAKING:
                        outcome.get()
                        outcome, lost_unmade = None, 0
                    _feed(pool, worker, states, queue, units, scenes)
                if outcome is not None:
                    remaining -= 1
                    yield outcome
    finally:
        for worker in states:
            pool.end(worker)


def _feed(
    pool: Pool[Worker],
    worker: Worker,
    states: dict[Worker, _State],
    queue: SceneQueue,
    units: Sequence[Any],
    scenes: Sequence[str],
) -> None:
    """Give a worker its next unit, if one waits."""
    state = states[worker]
    state.index = queue.take(state.scene, [one.scene for one in states.values() if one is not state])
    if state.index is not None:
        state.scene = scenes[state.index]
        pool.send(worker, state.index, units[state.index])
