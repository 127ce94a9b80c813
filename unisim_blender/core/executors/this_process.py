"""Units of work one after another, in this process."""

from __future__ import annotations

from collections.abc import Sequence

from .executor import MakeFunction, Outcomes, ResultT, UnitT, attempt, register
from .queue import SceneQueue, scenes_or_one
from .worker_state import OnWorker, WorkerState, ignore


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
