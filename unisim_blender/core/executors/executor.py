"""The protocol of an executor: it runs one function for many units of work, somewhere, and yields an outcome of each."""

from __future__ import annotations

import pickle
import traceback
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Generic, Literal, Protocol, TypeVar

from ..errors import UnisimError, in_a_line
from ..registry import Registry

Doing = Literal["starting", "unit", "idle", "lost"]
"""A worker starts; is at a unit; has none, because none waits; was ended from outside."""


@dataclass(frozen=True)
class WorkerState:
    """State that a worker enters. ``number`` counts workers from 0; the replacement of a lost one has its number.

    At a unit, ``index`` is the unit's, and ``loads_scene`` says whether the worker loads the unit's scene first,
    because it holds another one or none.
    """

    number: int
    doing: Doing
    index: int | None = None
    loads_scene: bool = False


OnWorker = Callable[[WorkerState], object]


def ignore(state: WorkerState) -> None:
    """Do nothing with what a worker does."""


UnitT = TypeVar("UnitT")
ResultT = TypeVar("ResultT")

MakeFunction = Callable[[], Callable[[UnitT], ResultT]]
"""Called once in every worker; returns the function that is then called once a unit. It loads what all units share, so that
a unit itself stays small."""

MAX_LOSSES = 3
"""A unit whose workers were ended from outside so many times has failed."""


class ProcessLost(UnisimError):
    """A worker's process was ended from outside, killed or out of memory, and running its unit again did not help."""


@dataclass(frozen=True)
class Outcome(Generic[ResultT]):
    """Outcome of the unit at ``index``: its ``result``, or the ``error`` that it raised; ``details`` are the traceback
    of one that is no `UnisimError`."""

    index: int
    result: ResultT | None = None
    error: Exception | None = None
    details: str = ""

    def get(self) -> ResultT:
        if self.error is not None:
            raise self.error from (WorkerTraceback(self.details) if self.details else self.error.__cause__)
        return self.result  # type: ignore[return-value]  # None only where a unit's result is


Outcomes = Generator[Outcome[ResultT], None, None]
"""Closed, its workers end at once, in the middle of their units."""


class Executor(Protocol):
    """Where units of work are run. An executor knows nothing of what a unit is.

    ``make`` and the units pickle, and so do the results. Units do not depend on each other or on their order, and may be run
    more than once; the function writes its files itself.
    """

    def run(
        self,
        make: MakeFunction[UnitT, ResultT],
        units: Sequence[UnitT],
        jobs: int | None = None,
        scenes: Sequence[str] | None = None,
        on_worker: OnWorker = ignore,
    ) -> Outcomes[ResultT]:
        """Yield one outcome of every unit, in any order, as each is finished; a unit that fails ends no other.

        At most ``jobs`` units run at a time; None: as many as there are cores for. ``scenes`` are equal for units that one
        loaded scene serves; None: for all. A worker takes the units of the scene that it holds first. A unit whose
        worker is ended from outside is run again, `MAX_LOSSES` times at most. ``make`` is not called where there are no
        units; what it raises is raised here. ``on_worker`` is called here as workers begin something else.
        """


def attempt(index: int, function: Callable[..., ResultT], *arguments: Any) -> Outcome[ResultT]:
    """Call the function of a unit; whatever it raises is the outcome's error, which pickles."""
    try:
        return Outcome(index, function(*arguments))
    except UnisimError as error:
        return Outcome(index, error=_that_pickles(error))
    except Exception as error:
        return Outcome(index, error=_that_pickles(error), details=traceback.format_exc())


def results_of(outcomes: Outcomes[ResultT]) -> Generator[ResultT, None, None]:
    """Yield the results of outcomes. The first error is raised, and the workers end."""
    with closing(outcomes):
        for outcome in outcomes:
            yield outcome.get()


class WorkerTraceback(Exception):
    """Where a worker's function failed: the cause of what is raised in the caller's process."""

    def __str__(self) -> str:
        return f"\n{self.args[0]}"


def sentence(error: Exception) -> str:
    """Return what an outcome's error says, in one line."""
    return str(error) if isinstance(error, UnisimError) else f"{type(error).__name__}: {in_a_line(error)}"


def _that_pickles(error: Exception) -> Exception:
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # an error's own constructor may ask for more than its message
        return RuntimeError(sentence(error))
    return error


EXECUTORS: Registry[Executor] = Registry("an executor")
"""The registered executors by the name that `unisim render --executor` and `unisim batch --on` have for them."""
register = EXECUTORS.add
