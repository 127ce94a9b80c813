"""Fields, queried by `encode` and `two_layers` one after the other, which have gradients."""

from __future__ import annotations

from torch import Tensor

from ..encode import encode
from ..encode.gradient_sink import GradientSink
from ..grid_shape import GridArrays
from ..mlp import two_layers


def query(
    grid: GridArrays, table: Tensor, x: Tensor, w1: Tensor, w2: Tensor, bias: Tensor,
    index: Tensor | None = None, sink: GradientSink | None = None,
) -> Tensor:  # fmt: skip
    """See `field.query`."""
    return two_layers(encode(grid, table, x, index, sink), w1, w2, bias)
