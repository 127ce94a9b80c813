"""Encodings of points by multiresolution hash grids: Mueller et al., "Instant Neural Graphics Primitives", 2022.

A table is large and a batch touches few of its rows: autograd would make and add a gradient of the whole table for each
encoding, which costs more than the encoding. A `GradientSink` collects the encodings' gradients until a step's backward
passes are finished, then adds them to the table's gradient in a fixed order.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import native
from . import gpu
from .devices import kernel_threads
from .dispatch import Operation, on_cpu_or_gpu
from .grid_shape import GridArrays, GridShape

_PRIMES = (1, 2654435761, 805459861)
# parallel loss branches go backward in threads of their own; a sink has a list for each
_BRANCH: ContextVar[int] = ContextVar("branch", default=0)


def encode(
    grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None, sink: GradientSink | None = None
) -> Tensor:
    """Return encodings (N, levels * features) of points x (N, 3) in the unit cube.

    table (rows, features), or (grids, rows, features) with the number of each point's grid in ``index`` (N,). The
    compiled kernels put the encodings' gradients into ``sink``, where there is one, in place of the table's gradient
    for autograd.
    """
    assert x.shape[1:] == (3,), x.shape
    assert table.shape[-2:] == (grid.rows, grid.shape.features), table.shape
    return OPERATION(grid, table, x, index, sink)


@contextmanager
def as_branch(number: int) -> Iterator[None]:
    """Order the gradients that this thread puts into sinks inside the context after those of branches with lower
    numbers."""
    token = _BRANCH.set(number)
    try:
        yield
    finally:
        _BRANCH.reset(token)


class GradientSink:
    """Collects gradients of encodings by one table, which `pour` adds to the table's gradient."""

    def __init__(self) -> None:
        self._waiting: dict[int, list[tuple[GridArrays, Tensor, Tensor | None, Tensor]]] = {}

    def put(self, grid: GridArrays, x: Tensor, index: Tensor | None, grad: Tensor) -> None:
        """Put in gradients (N, width) of encodings of points x (N, 3), with the number of each point's grid in
        ``index`` (N,) int32."""
        self._waiting.setdefault(_BRANCH.get(), []).append((grid, x, index, grad))

    def pour(self, into: Tensor) -> None:
        """Add all gradients that were put in to a gradient of the table's shape, by branches and then in their
        order."""
        for _, parts in sorted(self._waiting.items()):
            for grid, x, index, grad in parts:
                add_to_table(grid, x, index, grad, into)
        self._waiting.clear()

    def clear(self) -> None:
        """Remove all gradients."""
        self._waiting.clear()


def add_to_table(grid: GridArrays, x: Tensor, index: Tensor | None, grad: Tensor, into: Tensor) -> None:
    """Add the table's gradient of one encoding, see `GradientSink.put`, by the compiled kernel: contiguous
    tensors. A GPU adds up in any order."""
    if gpu.serves(x):
        of = gpu.encoded_points(grid.shape, into, x, index)
        gpu.launch("encode_table_gradient", x, len(x) * grid.shape.levels, of, len(x), grad, into)
        return
    lib = native.library()
    assert lib is not None
    lib.unisim_encode_backward_table(
        ctypes.byref(grid.struct), x.data_ptr(), gpu.pointer(index), len(x), grad.data_ptr(),
        into.data_ptr(), kernel_threads(),
    )  # fmt: skip


@functools.cache
def _scales(shape: GridShape, device: torch.device, dtype: torch.dtype) -> Tensor:
    """Return a shape's cells along the axes (levels, 3), made once on each device."""
    return torch.tensor(shape.scale, dtype=torch.float32, device=device).to(dtype)


def encode_reference(
    grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None, sink: GradientSink | None = None
) -> Tensor:
    """`encode` in plain torch, any float type and device. Autograd makes the table's gradient, whatever ``sink`` is."""
    flat = table.reshape(-1, grid.shape.features)
    base: Tensor | int = 0 if index is None else index.long() * grid.rows
    rows, weights = [], []
    levels = zip(_scales(grid.shape, x.device, x.dtype), *grid.layout, strict=True)
    for scale, offset, size, stride_y, stride_z in levels:
        # a point on or beyond a face, or NaN, stands on the face and does not move with x
        p = torch.where((x > 0) & (x < 1), x, torch.nan_to_num(x.detach(), nan=0.0).clamp(0, 1)) * scale
        lower = torch.minimum(p.detach().floor(), (scale.ceil() - 1).clamp_min(0))
        fraction = p - lower
        i = lower.long()
        for corner in range(8):
            bits = (corner & 1, corner >> 1 & 1, corner >> 2)
            v = [i[:, a] + bits[a] for a in range(3)]
            if stride_y:
                row = v[0] + v[1] * stride_y + v[2] * stride_z
            else:
                mixed = v[0] ^ (v[1] * _PRIMES[1] & 0xFFFFFFFF) ^ (v[2] * _PRIMES[2] & 0xFFFFFFFF)
                row = mixed & (size - 1)
            near = [fraction[:, a] if bits[a] else 1 - fraction[:, a] for a in range(3)]
            rows.append(base + offset + row)
            weights.append(near[0] * near[1] * near[2])
    # taken from the table in one go: each time costs a gradient of the whole table
    values = flat.index_select(0, torch.stack(rows, -1).view(-1)).view(
        len(x), grid.shape.levels, 8, grid.shape.features
    )
    return (torch.stack(weights, -1).view(len(x), grid.shape.levels, 8, 1) * values).sum(2).flatten(1)


def encode_compiled(
    grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None, sink: GradientSink | None = None
) -> Tensor:
    """`encode` by the compiled kernels."""
    numbers = None if index is None else index.to(torch.int32).contiguous()
    out: Tensor = _Encode.apply(grid, table, x, numbers, sink)  # type: ignore[no-untyped-call]
    return out


class _Encode(torch.autograd.Function):
    """The compiled encoding, forward and backward."""

    @staticmethod
    def forward(
        ctx: Any, grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None, sink: GradientSink | None
    ) -> Tensor:
        table, x = table.contiguous(), x.contiguous()
        ctx.grid, ctx.index, ctx.sink = grid, index, sink
        ctx.save_for_backward(table, x)
        out = x.new_empty(len(x), grid.shape.width)
        if gpu.serves(x):
            of = gpu.encoded_points(grid.shape, table, x, index)
            gpu.launch("encode", x, len(x) * grid.shape.levels, of, len(x), out)
            return out
        lib = native.library()
        assert lib is not None
        status = lib.unisim_encode_forward(
            ctypes.byref(grid.struct), x.data_ptr(), gpu.pointer(index), len(x), table.data_ptr(), out.data_ptr(),
            kernel_threads(),
        )  # fmt: skip
        assert status == 0, status
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[None, Tensor | None, Tensor | None, None, None]:
        table, x = ctx.saved_tensors
        grad = grads[0].contiguous()
        # rows are read at once
        grad = grad if grad.data_ptr() % 16 == 0 else grad.clone()
        grid, index = ctx.grid, ctx.index
        grad_table = grad_x = None
        if ctx.needs_input_grad[1]:
            if ctx.sink is not None:
                ctx.sink.put(grid, x, index, grad)
            else:
                grad_table = torch.zeros_like(table)
                add_to_table(grid, x, index, grad, grad_table)
        if ctx.needs_input_grad[2]:
            grad_x = torch.empty_like(x)
            if gpu.serves(x):
                of = gpu.encoded_points(grid.shape, table, x, index)
                gpu.launch("encode_point_gradient", x, len(x), of, len(x), grad, grad_x)
                return None, grad_table, grad_x, None, None
            lib = native.library()
            assert lib is not None
            lib.unisim_encode_backward_input(
                ctypes.byref(grid.struct), x.data_ptr(), gpu.pointer(index), len(x), table.data_ptr(), grad.data_ptr(),
                grad_x.data_ptr(), kernel_threads(),
            )  # fmt: skip
        return None, grad_table, grad_x, None, None


OPERATION = Operation(
    encode_reference,
    lambda grid, table, x, index=None, sink=None: (x, table),
    compiled=encode_compiled,
    takes=on_cpu_or_gpu,
)
