"""Voxel grids of checkpoints: small where most voxels are alike, and the same when they are read."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from unisim_blender.core.training.packed_voxels import packed, unpacked

SHAPE = torch.Size((30, 20, 10))


def grid(dtype: torch.dtype, share: float) -> Tensor:
    """A grid of which a share of the entries are not as the first one is."""
    generator = torch.Generator().manual_seed(3)
    values = torch.full(SHAPE, 7, dtype=dtype)
    other = torch.rand(SHAPE, generator=generator) < share
    other[0, 0, 0] = False
    values[other] = torch.randint(0, 200, (int(other.sum()),), generator=generator).to(dtype)
    return values


@pytest.mark.parametrize("dtype", [torch.uint8, torch.int32, torch.float32])
@pytest.mark.parametrize("share", [0.0, 0.02, 0.9])
def test_a_grid_is_read_as_it_was(dtype: torch.dtype, share: float) -> None:
    before = grid(dtype, share)
    found = packed("occupancy.score", before)
    assert sum(part.nbytes for part in found.values()) <= before.nbytes
    assert (len(found) == 3) == (share < 0.5)
    after = unpacked({**found, "other": torch.ones(2)}, {"occupancy.score": SHAPE})
    assert after.keys() == {"occupancy.score", "other"}
    assert after["occupancy.score"].dtype == dtype and torch.equal(after["occupancy.score"], before)


@pytest.mark.parametrize("part", ["fill", "index", "value"])
def test_broken_grids(part: str) -> None:
    found = packed("seen", grid(torch.uint8, 0.02))
    own = found[f"seen.{part}"]
    for other in (own[:-1], own.float()[None], own.int() - 10**6):
        broken = {**found, f"seen.{part}": other}
        if part == "index" or other.shape != own.shape:
            with pytest.raises(ValueError, match="seen (is no packed grid|does not fit a grid)"):
                unpacked(broken, {"seen": SHAPE})
    with pytest.raises(KeyError):
        unpacked({name: value for name, value in found.items() if name == "seen.index"}, {"seen": SHAPE})
