"""Multiresolution hash grids: the encoding of Mueller et al., "Instant Neural Graphics Primitives", 2022.

`encode_reference` says in plain torch what an encoding is. `encode` gives the same through the compiled kernels where the
tensors are float32 on the CPU, through Triton's on a GPU. Points lie in the unit cube; several grids of one shape can lie in one
table (an actor's each).
"""

from __future__ import annotations

import ctypes
import functools
from typing import Any

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from .. import native
from .devices import kernel_threads
from .gradient_sink import GradientSink, add_to_table
from .grid_shape import GridArrays, GridShape
from .kernel_choice import kernels_for

_PRIMES = (1, 2654435761, 805459861)


def encode_reference(grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None) -> Tensor:
    """Encodings (N, levels * features) of points x (N, 3) in the unit cube, any float type and device.

    table (rows, features), or (grids, rows, features) with the number of each point's grid in ``index`` (N,).
    """
    flat = table.reshape(-1, grid.shape.features)
    base: Tensor | int = 0 if index is None else index.long() * grid.rows
    rows, weights = [], []
    for level in range(grid.shape.levels):
        scale = torch.as_tensor(grid.scale[level], dtype=x.dtype, device=x.device)
        # a point on or beyond a face, or NaN, stands on the face and does not move with x
        p = torch.where((x > 0) & (x < 1), x, torch.nan_to_num(x.detach(), nan=0.0).clamp(0, 1)) * scale
        lower = torch.minimum(p.detach().floor(), (scale.ceil() - 1).clamp_min(0))
        fraction = p - lower
        i = lower.long()
        for corner in range(8):
            bits = (corner & 1, corner >> 1 & 1, corner >> 2)
            v = [i[:, a] + bits[a] for a in range(3)]
            if grid.stride_y[level]:
                row = v[0] + v[1] * int(grid.stride_y[level]) + v[2] * int(grid.stride_z[level])
            else:
                mixed = v[0] ^ (v[1] * _PRIMES[1] & 0xFFFFFFFF) ^ (v[2] * _PRIMES[2] & 0xFFFFFFFF)
                row = mixed & (int(grid.size[level]) - 1)
            near = [fraction[:, a] if bits[a] else 1 - fraction[:, a] for a in range(3)]
            rows.append(base + int(grid.offset[level]) + row)
            weights.append(near[0] * near[1] * near[2])
    # taken from the table in one go: each time costs a gradient of the whole table
    values = flat.index_select(0, torch.stack(rows, -1).view(-1)).view(len(x), grid.shape.levels, 8, grid.shape.features)
    return (torch.stack(weights, -1).view(len(x), grid.shape.levels, 8, 1) * values).sum(2).flatten(1)


def _pointer(tensor: Tensor | None) -> int | None:
    return None if tensor is None else tensor.data_ptr()


class _Encode(torch.autograd.Function):
    """The compiled encoding, forward and backward."""

    @staticmethod
    def forward(ctx: Any, grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None, sink: GradientSink | None) -> Tensor:
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


class _EncodeOnGpu(torch.autograd.Function):
    """Triton's encoding, forward and backward."""

    @staticmethod
    def forward(ctx: Any, grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None) -> Tensor:
        from .triton.grid import encode_forward

        ctx.grid, ctx.index = tensors_of(grid.shape, str(x.device)), index
        table, x = table.contiguous(), x.contiguous()
        ctx.save_for_backward(table, x)
        return encode_forward(ctx.grid, table, x, index)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[None, Tensor | None, Tensor | None, None]:
        from .triton.grid import encode_backward

        table, x = ctx.saved_tensors
        _, of_table, of_points, _ = ctx.needs_input_grad
        return None, *encode_backward(ctx.grid, table, x, ctx.index, grads[0].contiguous(), of_table, of_points), None


@functools.cache
def tensors_of(shape: GridShape, device: str) -> Any:
    """A grid's numbers as Triton's kernels read them: `triton.grid.GridTensors`."""
    from .triton.grid import GridTensors

    def integers(values: list[int]) -> Tensor:
        return torch.tensor(values, dtype=torch.int32, device=device)

    scale = torch.tensor(shape.scale, dtype=torch.float32, device=device)
    offset, size, stride_y, stride_z = (integers(values) for values in shape.layout())
    return GridTensors(scale, offset, size, stride_y, stride_z, shape.rows, shape.features)


def encode(grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None, sink: GradientSink | None = None) -> Tensor:
    """`encode_reference`, by the compiled kernels or Triton's where they apply.

    These leave what makes the table's gradient in ``sink``, where there is one, and autograd then sees none.
    """
    assert x.shape[1:] == (3,), x.shape
    assert table.shape[-2:] == (grid.rows, grid.shape.features), table.shape
    kernels = kernels_for(x, table)
    if kernels is None:
        return encode_reference(grid, table, x, index)
    numbers = None if index is None else index.to(torch.int32).contiguous()
    if kernels == "triton":
        there: Tensor = _EncodeOnGpu.apply(grid, table, x, numbers)  # type: ignore[no-untyped-call]
        return there
    out: Tensor = _Encode.apply(grid, table, x, numbers, sink)  # type: ignore[no-untyped-call]
    return out
