"""What an executor of a batch is: it runs every unit, and a unit that fails ends no other."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

from ...errors import UnisimError, in_a_line

Run = Callable[[Any], Any]
MakeRun = Callable[[], Run]
"""Called once in every worker; returns the function that is then called for each unit. It pickles."""


class HasScene(Protocol):
    """What executors know of a unit."""

    @property
    def scene(self) -> str:
        """Equal for units that one loaded scene renders."""
        ...


@dataclass(frozen=True)
class Outcome:
    """What came of the unit at ``index``: its ``result``, or the sentence of its ``failure``; ``details`` say where it failed."""

    index: int
    result: Any = None
    failure: str | None = None
    details: str = ""


class BatchExecutor(Protocol):
    """Where the units of a batch are run."""

    def run(self, make: MakeRun, units: Sequence[HasScene], jobs: int) -> Iterator[Outcome]:
        """Yield the outcome of every unit once, as each is finished; at most ``jobs`` units run at a time.

        A worker takes the units of the scene that it holds first. Where the caller stops early, workers end at once.
        """
        ...


def attempt(run: Run, index: int, unit: Any) -> Outcome:
    """Run a unit; whatever it raises is its failure."""
    try:
        return Outcome(index, run(unit))
    except UnisimError as error:
        return Outcome(index, failure=str(error))
    except Exception as error:
        return Outcome(index, failure=f"{type(error).__name__}: {in_a_line(error)}", details=traceback.format_exc())


BATCH_EXECUTORS: dict[str, BatchExecutor] = {}
"""The registered executors by the name that `unisim batch --on` has for them."""


def register(name: str, executor: BatchExecutor) -> None:
    """Register an executor. Raises `ValueError` for a name that is taken."""
    if name in BATCH_EXECUTORS:
        raise ValueError(f"there is an executor {name!r} already")
    BATCH_EXECUTORS[name] = executor
