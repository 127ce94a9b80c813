"""Units of work in several processes of this machine, of one thread each."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from typing import Any

from ...processes import THREAD_VARIABLES, end_with_parent
from .executor import MakeFunction, ProcessLost, Result, Unit, register


class Processes:
    """Runs units in ``jobs`` processes, fewer where there are fewer units. Where the caller stops early or fails they
    end at once, in the middle of their units; where it is killed they end, too."""

    def run(self, make: MakeFunction[Unit, Result], units: Sequence[Unit], jobs: int) -> Iterator[Result]:
        """See `Executor.run`."""
        if not units:
            return
        with _pool(min(jobs, len(units)), make) as pool:
            waiting: set[Future[Result]] = {pool.submit(_run_unit, unit) for unit in units}
            while waiting:
                finished, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in finished:
                    try:
                        yield future.result()
                    except BrokenProcessPool as error:
                        raise ProcessLost("a process was ended from outside (out of memory?)") from error


register("processes", Processes())


@contextmanager
def _pool(jobs: int, make: MakeFunction[Unit, Result]) -> Iterator[ProcessPoolExecutor]:
    """Worker processes; where the body fails or is interrupted they end at once, in the middle of their units."""
    # a forked child would keep the parent's threads' locks
    pool = ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _start_worker, (make,))
    try:
        yield pool
    except BaseException:
        for process in list((getattr(pool, "_processes", None) or {}).values()):
            process.kill()
        raise
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


_function: Callable[[Any], Any] | None = None
"""What a worker process calls for each unit, made once when it starts."""


def _start_worker(make: MakeFunction[Unit, Result]) -> None:
    global _function
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole group; the parent decides
    end_with_parent()
    for name in THREAD_VARIABLES:
        os.environ[name] = "1"  # for libraries that are imported from here on
    _function = make()


def _run_unit(unit: Any) -> Any:
    assert _function is not None
    return _function(unit)
