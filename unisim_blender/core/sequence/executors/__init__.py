"""Executors by name: where the units of work of a sequence are run. Another one is a file in this folder
and a line here, which registers it."""

from __future__ import annotations

from .executor import EXECUTORS as EXECUTORS
from .executor import Executor

# isort: off
from .this_process import ThisProcess as ThisProcess
from .processes import Processes as Processes


def usual_executor(jobs: int, units: int) -> Executor:
    """Return what runs so many units where nobody names an executor: processes, where more than one would have work."""
    return EXECUTORS["processes" if jobs > 1 and units > 1 else "this-process"]
