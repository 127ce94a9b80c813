"""Units of work one after another, in this process."""

from __future__ import annotations

from collections.abc import Sequence

from .executor import MakeFunction, Outcomes, Result, Unit, attempt, register
from .queue import SceneQueue, scenes_or_one


class ThisProcess:
    """Runs units scene by scene; ``jobs`` has no effect."""

    def run(
        self,
        make: MakeFunction[Unit, Result],
        units: Sequence[Unit],
        jobs: int | None = None,
        scenes: Sequence[str] | None = None,
    ) -> Outcomes[Result]:
        """See `Executor.run`."""
        if not units:
            return
        scenes = scenes_or_one(scenes, len(units))
        function, queue, held = make(), SceneQueue(scenes), None
        while (index := queue.take(held)) is not None:
            held = scenes[index]
            yield attempt(index, function, units[index])


register("this-process", ThisProcess())
