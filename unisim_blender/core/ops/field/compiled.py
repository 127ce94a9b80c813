"""Fields queried in one compiled kernel: encodings of a block of points stay in the processor's cache."""

from __future__ import annotations

import ctypes

import torch
from torch import Tensor

from ... import native
from ..devices import kernel_threads
from ..encode.gradient_sink import GradientSink
from ..grid_shape import GridArrays
from ..mlp.compiled import network_struct


def query(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Tensor:  # fmt: skip
    """See `field.query`, without gradients."""
    lib = native.library()
    assert lib is not None
    w1, w2, bias, x, table = (value.detach().contiguous() for value in (w1, w2, bias, x, table))
    numbers = None if index is None else index.to(torch.int32).contiguous()
    out = torch.empty(len(x), len(w2))
    status = lib.unisim_field_forward(
        ctypes.byref(grid.struct), x.data_ptr(), None if numbers is None else numbers.data_ptr(), len(x),
        table.data_ptr(),
        ctypes.byref(network_struct(w1, w2, bias)), out.data_ptr(), kernel_threads(),
    )  # fmt: skip
    assert status == 0, status
    return out
