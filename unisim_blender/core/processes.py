"""What processes that share a job have in common: one thread each, and none outlives the one that started it."""

from __future__ import annotations

import multiprocessing
import os
import threading

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""How many threads libraries use that are imported after these are set."""


def end_with_parent() -> None:
    """Have this process end when its parent is gone, killed or not: nobody would wait for its work."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)
