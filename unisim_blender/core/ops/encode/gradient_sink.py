"""Gradients of hash grids' tables, kept until a step's backward passes are through, then added up in one order.

A table is large and a batch touches few of its rows: a gradient of the whole table for each encoding, which autograd
would make and add, costs more than the encoding. Shares of a step go backward in threads of their own; here each has
a list of its own.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from torch import Tensor

from ... import native
from ..devices import kernel_threads
from ..grid_shape import GridArrays

_BRANCH: ContextVar[int] = ContextVar("branch", default=0)


@contextmanager
def as_branch(number: int) -> Iterator[None]:
    """What goes into sinks inside, in this thread, comes after what branches with lower numbers put there."""
    token = _BRANCH.set(number)
    try:
        yield
    finally:
        _BRANCH.reset(token)


class GradientSink:
    """Takes gradients of encodings by one table; `pour` adds what they make of the table's gradient to that."""

    def __init__(self) -> None:
        self._waiting: dict[int, list[tuple[GridArrays, Tensor, Tensor | None, Tensor]]] = {}

    def put(self, grid: GridArrays, x: Tensor, index: Tensor | None, grad: Tensor) -> None:
        """Gradients (N, width) of encodings of points x (N, 3), with the number of each point's grid in ``index``
        (N,) int32."""
        self._waiting.setdefault(_BRANCH.get(), []).append((grid, x, index, grad))

    def pour(self, into: Tensor) -> None:
        """Add everything that was put here to a gradient of the table's shape, by branches and then in its order."""
        for _, parts in sorted(self._waiting.items()):
            for grid, x, index, grad in parts:
                add_to_table(grid, x, index, grad, into)
        self._waiting.clear()

    def clear(self) -> None:
        """Forget what was put here."""
        self._waiting.clear()


def add_to_table(grid: GridArrays, x: Tensor, index: Tensor | None, grad: Tensor, into: Tensor) -> None:
    """Add the table's gradient of one encoding, see `GradientSink.put`, by the compiled kernel: contiguous CPU
    tensors."""
    lib = native.library()
    assert lib is not None
    lib.unisim_encode_backward_table(
        ctypes.byref(grid.struct), x.data_ptr(), None if index is None else index.data_ptr(), len(x), grad.data_ptr(),
        into.data_ptr(), kernel_threads(),
    )  # fmt: skip
