"""Voxel grids of a checkpoint: most voxels are like the one before, and of these nothing is kept."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

START, VALUE = "start", "value"


def packed(name: str, grid: Tensor) -> dict[str, Tensor]:
    """Return a grid as where each run of equal entries starts (N,) and what they are (N,), by names that begin with ``name``;
    the grid itself where that is smaller."""
    flat = grid.detach().cpu().contiguous().view(-1)
    start = torch.cat([torch.zeros(1, dtype=torch.long), torch.nonzero(flat[1:] != flat[:-1])[:, 0] + 1])
    if len(start) * (4 + flat.element_size()) >= flat.nbytes:
        return {name: grid}
    return {f"{name}.{START}": start.int(), f"{name}.{VALUE}": flat[start]}


def unpacked(tensors: Mapping[str, Tensor], grids: Mapping[str, torch.Size]) -> dict[str, Tensor]:
    """Return the tensors with grids of these names and shapes in place of what `packed` made of them. Raises ValueError."""
    found = dict(tensors)
    for name, shape in grids.items():
        if f"{name}.{START}" not in found:
            continue
        start, value = (found.pop(f"{name}.{part}") for part in (START, VALUE))
        if start.ndim != 1 or start.dtype != torch.int32 or start.shape != value.shape:
            raise ValueError(f"{name} is no packed grid")
        lengths = torch.diff(start.long(), append=torch.tensor([shape.numel()]))
        if not len(start) or start[0] != 0 or int(lengths.min()) <= 0:
            raise ValueError(f"{name} does not fit a grid of {tuple(shape)} voxels")
        found[name] = value.repeat_interleave(lengths).view(shape)
    return found
