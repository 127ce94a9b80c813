"""Encodings by multiresolution hash grids, in plain torch: what the kernels are held to."""

from __future__ import annotations

import torch
from torch import Tensor

from ..grid_shape import GridArrays
from .gradient_sink import GradientSink

_PRIMES = (1, 2654435761, 805459861)


def encode(
    grid: GridArrays, table: Tensor, x: Tensor, index: Tensor | None = None, sink: GradientSink | None = None
) -> Tensor:
    """Encodings (N, levels * features) of points x (N, 3) in the unit cube, any float type and device.

    table (rows, features), or (grids, rows, features) with the number of each point's grid in ``index`` (N,).
    Autograd makes the table's gradient, whatever ``sink`` is.
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
    values = flat.index_select(0, torch.stack(rows, -1).view(-1)).view(
        len(x), grid.shape.levels, 8, grid.shape.features
    )
    return (torch.stack(weights, -1).view(len(x), grid.shape.levels, 8, 1) * values).sum(2).flatten(1)
