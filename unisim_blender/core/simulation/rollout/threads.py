"""Threads of a rollout: torch's own operations take one, as in a sequence, since their last bits depend on how many there are."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def torch_in_one_thread() -> Iterator[None]:
    """Let torch, where it has been imported, use one thread. The compiled kernels, whose results do not depend on threads, keep
    theirs."""
    if "torch" not in sys.modules:
        yield
        return
    from ...ops.devices import torch_threads

    with torch_threads(1):
        yield
