"""Units one after another, in this process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from .executor import HasScene, MakeRun, Outcome, attempt, register
from .queue import SceneQueue


class ThisProcess:
    """Runs units scene by scene; ``jobs`` has no effect."""

    def run(self, make: MakeRun, units: Sequence[HasScene], jobs: int) -> Iterator[Outcome]:
        """See `BatchExecutor.run`."""
        if not units:
            return
        run, queue, held = make(), SceneQueue(units), None
        while (index := queue.take(held)) is not None:
            held = units[index].scene
            yield attempt(run, index, units[index])


register("this-process", ThisProcess())
