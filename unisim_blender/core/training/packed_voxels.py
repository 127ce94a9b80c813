"""Voxel grids of a checkpoint: most voxels are like the first, and of these nothing is kept."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

FILL, INDEX, VALUE = "fill", "index", "value"


def packed(name: str, grid: Tensor) -> dict[str, Tensor]:
    """Return a grid as the value of its first entry, and numbers (N,) and values (N,) of those that differ, by names that begin
    with ``name``; the grid itself where that is smaller."""
    flat = grid.detach().cpu().contiguous().view(-1)
    index = torch.nonzero(flat != flat[0])[:, 0]
    if len(index) * (4 + flat.element_size()) >= flat.nbytes:
        return {name: grid}
    return {f"{name}.{FILL}": flat[:1].clone(), f"{name}.{INDEX}": index.int(), f"{name}.{VALUE}": flat[index]}


def unpacked(tensors: Mapping[str, Tensor], grids: Mapping[str, torch.Size]) -> dict[str, Tensor]:
    """Return the tensors with grids of these names and shapes in place of what `packed` made of them. Raises ValueError."""
    found = dict(tensors)
    for name, shape in grids.items():
        if f"{name}.{INDEX}" not in found:
            continue
        fill, index, value = (found.pop(f"{name}.{part}") for part in (FILL, INDEX, VALUE))
        size = shape.numel()
        if fill.shape != (1,) or index.ndim != 1 or index.dtype != torch.int32 or index.shape != value.shape:
            raise ValueError(f"{name} is no packed grid")
        if len(index) and not 0 <= int(index.min()) <= int(index.max()) < size:
            raise ValueError(f"{name} does not fit a grid of {tuple(shape)} voxels")
        grid = torch.full((size,), fill[0].item(), dtype=value.dtype)
        grid[index.long()] = value
        found[name] = grid.view(shape)
    return found
