"""Common behaviour of processes that share a job: one thread each, and none outlives the one that started it."""

from __future__ import annotations

import multiprocessing
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

THREAD_VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS")
"""How many threads libraries use that are imported after these are set."""

WORKER_VARIABLE = "UNISIM_WORKER"
"""A worker's number among those of its machine, from 0 on."""


def wait_briefly() -> None:
    """Have OpenMP's threads give their core up soon when they wait: by default they keep it busy for milliseconds,
    which the kernels' own threads need. To be called before torch is imported; what the user set stays."""
    os.environ.setdefault("GOMP_SPINCOUNT", "2000")


def end_with_parent() -> None:
    """Have this process end when its parent is gone, killed or not: nobody would wait for its work."""
    threading.Thread(target=_wait_for_parent, daemon=True).start()


def _wait_for_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


@contextmanager
def single_threaded() -> Iterator[None]:
    """Let torch, where it has been imported, use one thread."""
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
