"""What nobody saw, continued from what is above it and beside it.

A parked car hides the pavement and the foot of the wall behind it. Nothing recorded says what is there, and an edit that takes
the car away shows it. So the ground goes on level and looks like its surroundings; what stands above it goes on downwards: a
wall reaches the ground, and open air stays open.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ..fields.ground import CELL_M
from ..fields.occupancy import OccupancyTrainer
from ..fields.scene import SceneModel

REACH_M = 2.0
"""How high above the ground things are continued downwards: a van's height."""
_DRAWS, _POINTS = 2048, 192
_BESIDE_M = 2.0
_BAND_M = 0.3
"""Distances further than this from a surface are not compared."""


class Hidden:
    """Draws hidden places and compares them with what is next to them.

    ``known_ground`` (C, 2) are the cells whose ground height can be trusted; ``still_boxes`` the poses (B, 4, 4), box to world,
    and sizes (B, 3) of actors that never move, whose inside the static field is never asked for.
    """

    def __init__(
        self, model: SceneModel, occupancy: OccupancyTrainer, known_ground: Tensor, still_boxes: tuple[Tensor, Tensor] | None
    ) -> None:
        self.model, self.occupancy, self.known_ground, self.still_boxes = model, occupancy, known_ground, still_boxes

    def loss(self, generator: torch.Generator) -> Tensor:
        """Mean disagreement of hidden places with their surroundings."""
        total = self.model.ground.heights.new_zeros(())
        # only the tables of hidden places learn: through the network that all places share, looks and their models would grow
        # together without end
        network = self.model.static.network.requires_grad_(False)
        if len(self.known_ground):
            total = total + self._unseen(generator)
        if self.still_boxes is not None:
            total = total + self._under_boxes(*self.still_boxes, generator)
        network.requires_grad_(True)
        return total

    def _unseen(self, generator: torch.Generator) -> Tensor:
        model, device = self.model, self.known_ground.device

        def rand(*shape: int) -> Tensor:
            return torch.rand(*shape, generator=generator, device=device)

        cells = self.known_ground[torch.randint(len(self.known_ground), (_DRAWS,), generator=generator, device=device)]
        place = (cells + rand(_DRAWS, 2)) * CELL_M
        height = rand(_DRAWS) * REACH_M
        # every other point is on the ground itself
        height[::2] = 0.0
        x = model.ground.under(place) + F.pad(height[:, None], (2, 0))
        pick = torch.nonzero(self.occupancy.hidden(x))[:_POINTS, 0]
        x, height = x[pick], height[pick]
        aloft = height > 0
        total = x.new_zeros(())
        if bool(aloft.any()):
            s, look = model.static(x[aloft])
            with torch.no_grad():
                above = x[aloft] + F.pad(0.1 + 0.5 * rand(len(s), 1), (2, 0))
                s_above, look_above = model.static(above)
                expected = torch.minimum(s_above, height[aloft])
            total = total + F.smooth_l1_loss(s.clamp(-_BAND_M, _BAND_M), expected.clamp(-_BAND_M, _BAND_M), beta=0.05)
            total = total + 0.1 * self._alike(look, look_above, above)
        if not bool(aloft.all()):
            ground = x[~aloft]
            s, look = model.static(ground)
            with torch.no_grad():
                beside = model.ground.under(ground[:, :2] + _BESIDE_M * (2 * rand(len(ground), 2) - 1))
                _, look_beside = model.static(beside)
            total = total + s.abs().mean() + 0.1 * self._alike(look, look_beside, beside)
        return total

    def _alike(self, look: Tensor, model_look: Tensor, at: Tensor) -> Tensor:
        """How unlike looks (N, F) are to their models at points (N, 3), of which those count that somebody saw.

        Hidden places that copy each other drift: nothing holds their looks.
        """
        seen = ~self.occupancy.hidden(at, alive=False)
        unlike = F.smooth_l1_loss(look, model_look, reduction="none").mean(-1)
        return (unlike * seen).sum() / seen.sum().clamp_min(1)

    def _under_boxes(self, poses: Tensor, sizes: Tensor, generator: torch.Generator) -> Tensor:
        """Under a box that never moves nobody saw the ground: nothing above it, and the look of its surroundings."""
        model, device, n = self.model, poses.device, _POINTS
        which = torch.randint(len(poses), (n,), generator=generator, device=device)
        unit = torch.rand(n, 3, generator=generator, device=device) - 0.5

        def place(local: Tensor) -> Tensor:
            world = torch.einsum("nij,nj->ni", poses[which][:, :3, :3], local) + poses[which][:, :3, 3]
            return model.frame.points(world)

        inside = place(unit * sizes[which])
        on_ground = model.ground.under(inside)
        s = model.static.distance(inside)
        expected = (inside - on_ground)[:, 2].clamp(-_BAND_M, _BAND_M)
        height = F.smooth_l1_loss(s.clamp(-_BAND_M, _BAND_M), expected, beta=0.05)
        # the nearer long side, and a little beyond it
        side = torch.sign(unit[:, 1]) * (0.5 * sizes[which][:, 1] + 0.2 + 0.8 * torch.rand(n, generator=generator, device=device))
        beyond = place(torch.stack([unit[:, 0] * sizes[which][:, 0], side, unit[:, 2] * 0], -1))
        beyond = model.ground.under(beyond)
        s_ground, look = model.static(on_ground)
        with torch.no_grad():
            _, outside = model.static(beyond)
        return height + s_ground.abs().mean() + 0.1 * F.smooth_l1_loss(look, outside)

    @torch.no_grad()
    def continued(self) -> Tensor:
        """Hidden voxels (M,), flat numbers, under something that was seen: it goes on down to the ground.

        Voxels decide, not the field: where nobody looked it has surfaces of its own making.
        """
        model, device = self.model, self.known_ground.device
        voxel, shape = model.config.voxel_m, model.occupancy.values.shape
        corner = torch.arange(0, CELL_M, voxel, device=device)
        place = ((self.known_ground * CELL_M)[:, None] + torch.cartesian_prod(corner, corner) + voxel / 4).reshape(-1, 2)
        column = model.occupancy.cells(model.ground.under(place)).unique()
        ground, levels = column % shape[2], round(REACH_M / voxel)
        seen, shown = self.occupancy.seen, self.occupancy.shown()
        goes_on = shown[column - ground + (ground + levels).clamp_max(shape[2] - 1)]
        found = []
        for level in reversed(range(levels)):
            cell = column - ground + (ground + level).clamp_max(shape[2] - 1)
            below = goes_on & ~seen[cell]
            found.append(cell[below])
            goes_on = below | shown[cell]
        return torch.cat(found).unique()
