"""Executors by name: where the units of work of a sequence are run. Another one is a file in this folder
and a line here."""

from __future__ import annotations

from .executor import Executor
from .processes import Processes
from .this_process import ThisProcess

EXECUTORS: dict[str, Executor] = {
    "this-process": ThisProcess(),
    "processes": Processes(),
}
"""By the name that `unisim render --executor` has for them."""


def usual_executor(jobs: int, units: int) -> Executor:
    """Return what runs so many units where nobody names an executor: processes, where more than one would have work."""
    return EXECUTORS["processes" if jobs > 1 and units > 1 else "this-process"]
