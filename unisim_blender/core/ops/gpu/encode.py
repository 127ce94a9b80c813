"""Encodings by multiresolution hash grids, by Triton's kernels, forward and backward.

A program works on BLOCK points at once and on every column of their encodings: each column looks its level's corners
up, and neighbours read neighbouring numbers of a row.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any

import torch
import triton
import triton.language as tl
from torch import Tensor
from torch.autograd.function import once_differentiable

from ..encode import GradientSink
from ..grid_shape import GridArrays, GridShape

BLOCK = 64


@dataclass(frozen=True)
class GridTensors:
    """A grid's numbers on a device: scale (L, 3) float32; offset, size, stride_y, stride_z (L,) int32, strides 0
    where a level is hashed; ``rows`` of one grid's table and ``features`` of a row."""

    scale: Tensor
    offset: Tensor
    size: Tensor
    stride_y: Tensor
    stride_z: Tensor
    rows: int
    features: int

    @property
    def width(self) -> int:
        """Length of an encoding."""
        return len(self.scale) * self.features


@triton.jit
def _along_axis(x, scale, points, there, level, column, AXIS: tl.constexpr):
    # where points stand in their cells along one axis: the cell's number, the fraction behind it, the scale, and
    # whether a point is inside of the cube; NaN and what is outside stand on the nearest face
    p = tl.load(x + points * 3 + AXIS, mask=there, other=0.0)
    s = tl.load(scale + level * 3 + AXIS, mask=column, other=1.0)[None, :]
    at = p[:, None] * s
    at = tl.where(at > 0, at, 0.0)
    at = tl.where(at < s, at, s)
    last = tl.maximum(tl.ceil(s) - 1, 0.0)
    cell = tl.minimum(tl.floor(at), last)
    return cell.to(tl.int32), at - cell, s, (p > 0) & (p < 1)


@triton.jit
def _row(i, j, k, size, stride_y, stride_z):
    # a vertex's row in its level
    mixed = i.to(tl.uint32) ^ (j.to(tl.uint32) * 2654435761) ^ (k.to(tl.uint32) * 805459861)
    hashed = (mixed & (size - 1).to(tl.uint32)).to(tl.int32)
    return tl.where(stride_y > 0, i + j * stride_y + k * stride_z, hashed)


@triton.jit
def _columns(
    index, offset, size, stride_y, stride_z, rows, points, there,
    INDEXED: tl.constexpr, WIDTH: tl.constexpr, WIDE: tl.constexpr, F: tl.constexpr,
):  # fmt: skip
    # what each column of the encodings reads: its level, the level's size and strides, where each point's numbers begin
    # there, and which of these numbers there are
    c = tl.arange(0, WIDE)
    column, level = c < WIDTH, c // F
    first = tl.load(offset + level, mask=column, other=0)[None, :].to(tl.int64)
    if INDEXED:
        number = tl.load(index + points, mask=there, other=0).to(tl.int64)
        first = first + number[:, None] * rows
    n = tl.load(size + level, mask=column, other=1)[None, :]
    step_y = tl.load(stride_y + level, mask=column, other=0)[None, :]
    step_z = tl.load(stride_z + level, mask=column, other=0)[None, :]
    return level, column, n, step_y, step_z, first * F + (c % F)[None, :], there[:, None] & column[None, :]


@triton.jit
def encode_points(
    x, index, table, scale, offset, size, stride_y, stride_z, rows, points,
    there, INDEXED: tl.constexpr, WIDTH: tl.constexpr, WIDE: tl.constexpr, F: tl.constexpr,
):  # fmt: skip
    """Encodings (BLOCK, WIDE) of points, zeros behind WIDTH."""
    level, column, size_n, step_y, step_z, first, mask = _columns(
        index, offset, size, stride_y, stride_z, rows, points, there, INDEXED, WIDTH, WIDE, F
    )
    i, fx, _, _ = _along_axis(x, scale, points, there, level, column, 0)
    j, fy, _, _ = _along_axis(x, scale, points, there, level, column, 1)
    k, fz, _, _ = _along_axis(x, scale, points, there, level, column, 2)
    code = tl.zeros_like(fx)
    for corner in tl.static_range(8):
        bx, by, bz = corner & 1, corner >> 1 & 1, corner >> 2
        weight = (fx if bx else 1 - fx) * (fy if by else 1 - fy) * (fz if bz else 1 - fz)
        at = first + _row(i + bx, j + by, k + bz, size_n, step_y, step_z).to(tl.int64) * F
        code += weight * tl.load(table + at, mask=mask, other=0.0)
    return code


# each value of a count would be compiled anew: for a 1, for multiples of 16, for all others
@triton.jit(do_not_specialize=["n", "rows"])
def _forward(
    x, index, table, scale, offset, size, stride_y, stride_z, rows, n, out,
    INDEXED: tl.constexpr, WIDTH: tl.constexpr, WIDE: tl.constexpr, F: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    points = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = points < n
    code = encode_points(
        x, index, table, scale, offset, size, stride_y, stride_z, rows, points, there, INDEXED, WIDTH, WIDE, F
    )  # fmt: skip
    c = tl.arange(0, WIDE)
    tl.store(out + points[:, None] * WIDTH + c[None, :], code, mask=there[:, None] & (c < WIDTH)[None, :])


@triton.jit(do_not_specialize=["n", "rows"])
def _backward(
    x, index, table, scale, offset, size, stride_y, stride_z, rows, n, grad,
    grad_table, grad_x, TABLE: tl.constexpr, POINTS: tl.constexpr, INDEXED: tl.constexpr, WIDTH: tl.constexpr,
    WIDE: tl.constexpr, F: tl.constexpr, BLOCK: tl.constexpr,
):  # fmt: skip
    points = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = points < n
    level, column, size_n, step_y, step_z, first, mask = _columns(
        index, offset, size, stride_y, stride_z, rows, points, there, INDEXED, WIDTH, WIDE, F
    )
    i, fx, sx, inside_x = _along_axis(x, scale, points, there, level, column, 0)
    j, fy, sy, inside_y = _along_axis(x, scale, points, there, level, column, 1)
    k, fz, sz, inside_z = _along_axis(x, scale, points, there, level, column, 2)
    c = tl.arange(0, WIDE)
    g = tl.load(grad + points[:, None] * WIDTH + c[None, :], mask=mask, other=0.0)
    gx, gy, gz = tl.zeros_like(fx), tl.zeros_like(fx), tl.zeros_like(fx)
    for corner in tl.static_range(8):
        bx, by, bz = corner & 1, corner >> 1 & 1, corner >> 2
        wx, wy, wz = fx if bx else 1 - fx, fy if by else 1 - fy, fz if bz else 1 - fz
        at = first + _row(i + bx, j + by, k + bz, size_n, step_y, step_z).to(tl.int64) * F
        if TABLE:
            tl.atomic_add(grad_table + at, wx * wy * wz * g, mask=mask, sem="relaxed")
        if POINTS:
            dot = g * tl.load(table + at, mask=mask, other=0.0)
            gx += (dot if bx else -dot) * wy * wz
            gy += (dot if by else -dot) * wx * wz
            gz += (dot if bz else -dot) * wx * wy
    if POINTS:
        # a point that stands on a face, or was put there, does not move with x
        tl.store(grad_x + points * 3, tl.where(inside_x, tl.sum(gx * sx, 1), 0.0), mask=there)
        tl.store(grad_x + points * 3 + 1, tl.where(inside_y, tl.sum(gy * sy, 1), 0.0), mask=there)
        tl.store(grad_x + points * 3 + 2, tl.where(inside_z, tl.sum(gz * sz, 1), 0.0), mask=there)


def grid_arguments(grid: GridTensors, table: Tensor, x: Tensor, index: Tensor | None) -> list[Any]:
    """Return the kernels' arguments for a grid, its table, points and the numbers of their grids."""
    # where there is one grid any tensor stands for the numbers, which nobody reads
    own = (grid.scale, grid.offset, grid.size, grid.stride_y, grid.stride_z)
    return [x, x if index is None else index, table, *own, grid.rows, len(x)]


def grid_constants(grid: GridTensors, index: Tensor | None) -> dict[str, Any]:
    """Return the compile-time constants of the kernels for a grid."""
    wide = max(16, triton.next_power_of_2(grid.width))
    return {"INDEXED": index is not None, "WIDTH": grid.width, "WIDE": wide, "F": grid.features, "BLOCK": BLOCK}


def _encode_forward(grid: GridTensors, table: Tensor, x: Tensor, index: Tensor | None) -> Tensor:
    """Encodings (N, width) of points x (N, 3) by a table; ``index`` (N,) int32 numbers each point's grid. All
    contiguous."""
    out = x.new_empty(len(x), grid.width)
    if len(x):
        programs = (triton.cdiv(len(x), BLOCK),)
        with torch.cuda.device_of(x):
            _forward[programs](*grid_arguments(grid, table, x, index), out, **grid_constants(grid, index))
    return out


def _encode_backward(
    grid: GridTensors, table: Tensor, x: Tensor, index: Tensor | None, grad: Tensor, of_table: bool, of_points: bool
) -> tuple[Tensor | None, Tensor | None]:
    """Gradients of the table and of points x (N, 3), those that are asked for, where encodings have the gradient
    ``grad`` (N, width). What a row of the table gets is added up in any order."""
    grad_table, grad_x = torch.zeros_like(table) if of_table else None, torch.empty_like(x) if of_points else None
    if len(x) and (of_table or of_points):
        programs = (triton.cdiv(len(x), BLOCK),)
        given = [grad if g is None else g for g in (grad_table, grad_x)]
        with torch.cuda.device_of(x):
            _backward[programs](
                *grid_arguments(grid, table, x, index), grad, *given, TABLE=of_table, POINTS=of_points,
                **grid_constants(grid, index),
            )  # fmt: skip
    return grad_table, grad_x


@functools.cache
def tensors_of(shape: GridShape, device: str) -> GridTensors:
    """Return a grid's numbers on a device, made once."""

    def integers(values: list[int]) -> Tensor:
        return torch.tensor(values, dtype=torch.int32, device=device)

    scale = torch.tensor(shape.scale, dtype=torch.float32, device=device)
    offset, size, stride_y, stride_z = (integers(values) for values in shape.layout())
    return GridTensors(scale, offset, size, stride_y, stride_z, shape.rows, shape.features)


class _Encode(torch.autograd.Function):
    """The encoding, forward and backward."""

    @staticmethod
    def forward(ctx: Any, grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None) -> Tensor:
        ctx.grid, ctx.index = tensors_of(grid.shape, str(x.device)), index
        table, x = table.contiguous(), x.contiguous()
        ctx.save_for_backward(table, x)
        return _encode_forward(ctx.grid, table, x, index)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *grads: Tensor) -> tuple[None, Tensor | None, Tensor | None, None]:
        table, x = ctx.saved_tensors
        _, of_table, of_points, _ = ctx.needs_input_grad
        return None, *_encode_backward(ctx.grid, table, x, ctx.index, grads[0].contiguous(), of_table, of_points), None


def encode(
    grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None, sink: GradientSink | None = None
) -> Tensor:
    """See `ops.encode.encode`; autograd makes the table's gradient, whatever ``sink`` is."""
    numbers = None if index is None else index.to(torch.int32).contiguous()
    out: Tensor = _Encode.apply(grid, table, x, numbers)
    return out
