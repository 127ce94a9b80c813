"""Units of work one after another, in this process."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from .executor import MakeFunction, Result, Unit, register


class ThisProcess:
    """Runs units in the order given; ``jobs`` has no effect."""

    def run(self, make: MakeFunction[Unit, Result], units: Sequence[Unit], jobs: int) -> Iterator[Result]:
        """See `Executor.run`."""
        if units:
            yield from map(make(), units)


register("this-process", ThisProcess())
