"""Fields queried in one kernel of Triton's: encodings stay in the program that makes them."""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

from ..encode import GradientSink
from ..grid_shape import GridArrays
from .encode import BLOCK, GridTensors, encode_points, grid_arguments, grid_constants, tensors_of


# each value of a count would be compiled anew: for a 1, for multiples of 16, for all others
@triton.jit(do_not_specialize=["n", "rows"])
def _field(
    x, index, table, scale, offset, size, stride_y, stride_z, rows, n, w1,
    w2, bias, out, INDEXED: tl.constexpr, WIDTH: tl.constexpr, WIDE: tl.constexpr, F: tl.constexpr,
    HIDDEN: tl.constexpr, UNITS: tl.constexpr, OUTPUTS: tl.constexpr, NUMBERS: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    points = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = points < n
    code = encode_points(
        x, index, table, scale, offset, size, stride_y, stride_z, rows, points, there, INDEXED, WIDTH, WIDE, F
    )  # fmt: skip
    c, u, v = tl.arange(0, WIDE), tl.arange(0, UNITS), tl.arange(0, NUMBERS)
    known = (c < WIDTH)[:, None] & (u < HIDDEN)[None, :]
    first = tl.load(w1 + u[None, :] * WIDTH + c[:, None], mask=known, other=0.0)
    # tf32 would give distances of a metre an error of a millimetre
    hidden = tl.maximum(tl.dot(code, first, input_precision="ieee"), 0.0)
    if OUTPUTS == 1:
        last = tl.load(w2 + u, mask=u < HIDDEN, other=0.0)
        tl.store(out + points, tl.sum(hidden * last[None, :], 1) + tl.load(bias), mask=there)
    else:
        known = (u < HIDDEN)[:, None] & (v < OUTPUTS)[None, :]
        last = tl.load(w2 + v[None, :] * HIDDEN + u[:, None], mask=known, other=0.0)
        b = tl.load(bias + v, mask=v < OUTPUTS, other=0.0)
        told = tl.dot(hidden, last, input_precision="ieee") + b[None, :]
        tl.store(out + points[:, None] * OUTPUTS + v[None, :], told, mask=there[:, None] & (v < OUTPUTS)[None, :])


def _field_forward(
    grid: GridTensors, table: Tensor, x: Tensor, index: Tensor | None, w1: Tensor, w2: Tensor, bias: Tensor
) -> Tensor:
    """W2 relu(W1 encoding) + bias (N, O) at points x (N, 3): weights (H, width) and (O, H), bias (O,), all
    contiguous."""
    hidden, outputs = len(w1), len(w2)
    out = x.new_empty(len(x), outputs)
    if len(x):
        programs = (triton.cdiv(len(x), BLOCK),)
        units, numbers = (max(16, triton.next_power_of_2(count)) for count in (hidden, outputs))
        with torch.cuda.device_of(x):
            _field[programs](
                *grid_arguments(grid, table, x, index), w1, w2, bias, out, HIDDEN=hidden, UNITS=units, OUTPUTS=outputs,
                NUMBERS=numbers, **grid_constants(grid, index),
            )  # fmt: skip
    return out


def query(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Tensor:  # fmt: skip
    """See `ops.field.query`, without gradients."""
    w1, w2, bias, x, table = (value.detach().contiguous() for value in (w1, w2, bias, x, table))
    numbers = None if index is None else index.to(torch.int32).contiguous()
    return _field_forward(tensors_of(grid.shape, str(x.device)), table, x, numbers, w1, w2, bias)
