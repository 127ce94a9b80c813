"""Encodings by multiresolution hash grids, by the compiled kernels."""

from __future__ import annotations

import ctypes
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from ... import native
from ..devices import kernel_threads
from ..grid_shape import GridArrays
from .gradient_sink import GradientSink, add_to_table


def encode(
    grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None, sink: GradientSink | None = None
) -> Tensor:
    """See `encode.encode`."""
    numbers = None if index is None else index.to(torch.int32).contiguous()
    out: Tensor = _Encode.apply(grid, table, x, numbers, sink)  # type: ignore[no-untyped-call]
    return out


def _pointer(tensor: Tensor | None) -> int | None:
    return None if tensor is None else tensor.data_ptr()


class _Encode(torch.autograd.Function):
    """The compiled encoding, forward and backward."""

    @staticmethod
    def forward(
        ctx: Any, grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None, sink: GradientSink | None
    ) -> Tensor:
        lib = native.library()
        assert lib is not None
        ctx.sink = sink
        table, x = table.contiguous(), x.contiguous()
        out = torch.empty(len(x), grid.shape.width)
        status = lib.unisim_encode_forward(
            ctypes.byref(grid.struct), x.data_ptr(), _pointer(index), len(x), table.data_ptr(), out.data_ptr(),
            kernel_threads(),
        )  # fmt: skip
        assert status == 0, status
        ctx.grid, ctx.index = grid, index
        ctx.save_for_backward(table, x)
        return out

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[None, Tensor | None, Tensor | None, None, None]:
        lib = native.library()
        assert lib is not None
        table, x = ctx.saved_tensors
        grad = grads[0].contiguous()
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
            lib.unisim_encode_backward_input(
                ctypes.byref(grid.struct), x.data_ptr(), _pointer(index), len(x), table.data_ptr(), grad.data_ptr(),
                grad_x.data_ptr(), kernel_threads(),
            )  # fmt: skip
        return None, grad_table, grad_x, None, None
