"""Encodings of points by multiresolution hash grids: Mueller et al., "Instant Neural Graphics Primitives", 2022."""

from __future__ import annotations

from torch import Tensor

from ..dispatch import Operation, on_cpu, on_gpu
from ..grid_shape import GridArrays
from . import reference
from .gradient_sink import GradientSink

OPERATION = Operation(
    reference.encode, lambda grid, table, x, index=None, sink=None: (x, table), {"gpu": on_gpu, "compiled": on_cpu}
)


def encode(
    grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None, sink: GradientSink | None = None
) -> Tensor:
    """Encodings (N, levels * features) of points x (N, 3) in the unit cube.

    table (rows, features), or (grids, rows, features) with the number of each point's grid in ``index`` (N,). The
    compiled kernels leave what makes the table's gradient in ``sink``, where there is one, and autograd then sees
    none.
    """
    assert x.shape[1:] == (3,), x.shape
    assert table.shape[-2:] == (grid.rows, grid.shape.features), table.shape
    return OPERATION(grid, table, x, index, sink)
