"""Voxel grids of checkpoints: small where most voxels are alike, and the same when they are read."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from unisim_blender.core.training.checkpoint import packed_grid, unpacked_grids

SHAPE = torch.Size((30, 20, 10))


def grid(dtype: torch.dtype, share: float) -> Tensor:
    """A grid of which a share of the entries differ from the others."""
    generator = torch.Generator().manual_seed(3)
    values = torch.full(SHAPE, 7, dtype=dtype)
    other = torch.rand(SHAPE, generator=generator) < share
    values[other] = torch.randint(0, 200, (int(other.sum()),), generator=generator).to(dtype)
    return values


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int32, torch.float32])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.9])
def test_a_grid_is_read_as_it_was(dtype: torch.dtype, share: float) -> None:
    before = grid(dtype, share)
    found = packed_grid("occupancy.score", before)
    assert sum(part.nbytes for part in found.values()) <= before.nbytes
    assert (len(found) == 2) == (share < 0.5)
    after = unpacked_grids({**found, "other": torch.ones(2)}, {"occupancy.score": SHAPE})
    assert after.keys() == {"occupancy.score", "other"}
    assert after["occupancy.score"].dtype == dtype and torch.equal(after["occupancy.score"], before)


def test_broken_grids() -> None:
    found = packed_grid("seen", grid(torch.uint8, 0.02))
    start, value = found["seen.start"], found["seen.value"]
    for no_grid in ({"start": start[:-1]}, {"start": start.long()}, {"start": start[None]}, {"value": value[:-1]}):
        with pytest.raises(ValueError, match="seen is no packed grid"):
            unpacked_grids({**found, **{f"seen.{part}": other for part, other in no_grid.items()}}, {"seen": SHAPE})
    for other in (start - 1, start + 1, start.flip(0), start * 1000, start[:0]):
        with pytest.raises(ValueError, match=r"seen does not fit a grid of \(30, 20, 10\) voxels"):
            unpacked_grids({"seen.start": other, "seen.value": value[: len(other)]}, {"seen": SHAPE})
    with pytest.raises(KeyError):
        unpacked_grids({"seen.start": start}, {"seen": SHAPE})
