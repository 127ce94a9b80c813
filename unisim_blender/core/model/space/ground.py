"""The height of the ground under the drive, as a grid."""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...geometry import FloatArray
from ...ops.constants import CLEARANCE_M, GROUND_CELL_M
from ..shapes import cells_of


class Ground(nn.Module):
    """The height grid as a tensor."""

    def __init__(self, size_m: FloatArray) -> None:
        super().__init__()
        self.register_buffer("heights", torch.zeros(cells_of(size_m[:2], GROUND_CELL_M)))

    heights: Tensor

    def height(self, x: Tensor) -> Tensor:
        """Ground heights (N,) under points (N, 3), volume coordinates; bilinear between cell centres."""
        extent = x.new_tensor([self.heights.shape[0] * GROUND_CELL_M, self.heights.shape[1] * GROUND_CELL_M])
        place = (x[:, :2] / extent * 2 - 1).flip(-1)
        grid = self.heights.to(x.dtype)[None, None]
        return F.grid_sample(grid, place[None, None], padding_mode="border", align_corners=False)[0, 0, 0]

    def under(self, x: Tensor) -> Tensor:
        """The points (N, 3) of the ground that lie over or under points (N, 3)."""
        return torch.cat([x[:, :2], self.height(x)[:, None]], -1)

    def above(self, x: Tensor) -> Tensor:
        """Which points (N, 3) are above the ground: (N,) bool."""
        return x[:, 2] > self.height(x) + CLEARANCE_M
