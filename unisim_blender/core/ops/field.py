"""Values of a field's network at points: encodings by a hash grid, and a perceptron of two layers behind it."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence

import torch
from torch import Tensor

from .. import native
from . import gpu
from .devices import kernel_threads
from .dispatch import Operation, on_cpu_or_gpu
from .encode import GradientSink, encode
from .grid_shape import GridArrays
from .mlp import network_struct, two_layers


def query(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Tensor:  # fmt: skip
    """Return ``w2 relu(w1 encoding) + bias`` (N, O) at points x (N, 3) in the unit cube: weights w1 (H, I), w2 (O, H),
    bias (O,); see `encode` for the others."""
    return OPERATION(grid, table, x, w1, w2, bias, index, sink)


def query_reference(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Tensor:  # fmt: skip
    """`query` by `encode` and `two_layers` one after the other, which have gradients."""
    return two_layers(encode(grid, table, x, index, sink), w1, w2, bias)


def query_compiled(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Tensor:  # fmt: skip
    """`query` in one compiled kernel, without gradients: encodings of a block of points stay in the processor's
    cache."""
    w1, w2, bias, x, table = (value.detach().contiguous() for value in (w1, w2, bias, x, table))
    numbers = None if index is None else index.to(torch.int32).contiguous()
    out = x.new_empty(len(x), len(w2))
    net = network_struct(w1, w2, bias)
    if gpu.serves(x):
        gpu.launch("field", x, len(x), gpu.encoded_points(grid.shape, table, x, numbers), net, len(x), out)
        return out
    lib = native.library()
    assert lib is not None
    status = lib.unisim_field_forward(
        ctypes.byref(grid.struct), x.data_ptr(), gpu.pointer(numbers), len(x), table.data_ptr(),
        ctypes.byref(net), out.data_ptr(), kernel_threads(),
    )  # fmt: skip
    assert status == 0, status
    return out


def _deciding(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Sequence[Tensor]:  # fmt: skip
    # one kernel for grid and network has no gradients
    learns = torch.is_grad_enabled() and (x.requires_grad or table.requires_grad or w2.requires_grad)
    return () if learns else (x, table, w2)


OPERATION = Operation(query_reference, _deciding, compiled=query_compiled, takes=on_cpu_or_gpu)
