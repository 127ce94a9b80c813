"""Executors of a batch by name: where its units are run. Another one is a file in this folder and a line here."""

from __future__ import annotations

from .executor import BATCH_EXECUTORS as BATCH_EXECUTORS
from .executor import BatchExecutor as BatchExecutor
from .executor import Outcome as Outcome

# isort: off
from .this_process import ThisProcess as ThisProcess
from .processes import Processes as Processes
