"""What a field's network says at points: encodings by a hash grid, and a perceptron of two layers behind it."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from ..dispatch import Operation, on_cpu, on_gpu
from ..encode.gradient_sink import GradientSink
from ..grid_shape import GridArrays
from . import reference


def _deciding(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Sequence[Tensor]:  # fmt: skip
    # one kernel for grid and network has no gradients
    learns = torch.is_grad_enabled() and (x.requires_grad or table.requires_grad or w2.requires_grad)
    return () if learns else (x, table, w2)


OPERATION = Operation(reference.query, _deciding, {"gpu": on_gpu, "compiled": on_cpu})


def query(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Tensor:  # fmt: skip
    """W2 relu(W1 encoding) + bias (N, O) at points x (N, 3) in the unit cube; see `encode` for the others."""
    return OPERATION(grid, table, x, w1, w2, bias, index, sink)
