"""What an executor is: it runs one function for many units of work, somewhere, and yields results as
they are finished."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol, TypeVar

Unit = TypeVar("Unit")
Result = TypeVar("Result")

MakeFunction = Callable[[], Callable[[Unit], Result]]
"""Called once in every process (or thread) that works; returns the function that is then called once a unit. It loads
what all units share, so that a unit itself stays small."""


class ProcessLost(Exception):
    """A process that worked for an executor ended without a result: killed, or out of memory."""


class Executor(Protocol):
    """Where units of work are run. An executor knows nothing of what a unit is.

    ``make`` and the units pickle, and so do the results. Units do not depend on each other or on their order, and the
    function writes its files itself: an executor on another machine needs the same file system.
    """

    def run(self, make: MakeFunction[Unit, Result], units: Sequence[Unit], jobs: int) -> Iterator[Result]:
        """Yield the result of every unit once, in any order, as each is finished; at most ``jobs`` units run at a time.

        ``make`` is not called where there are no units. What ``make`` or the function raises is raised here. Where the
        caller stops early, units that have not begun are not run. Raises `ProcessLost`.
        """
        ...


EXECUTORS: dict[str, Executor] = {}
"""The registered executors by the name that `unisim render --executor` has for them."""


def register(name: str, executor: Executor) -> None:
    """Register an executor: sequences can then be rendered by it. Raises `ValueError` for a name that is taken."""
    if name in EXECUTORS:
        raise ValueError(f"there is an executor {name!r} already")
    EXECUTORS[name] = executor
