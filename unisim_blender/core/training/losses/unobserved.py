"""Prior for unobserved places, which continues the geometry and appearance above and beside them.

A parked car hides the pavement and the foot of the wall behind it. Nothing recorded says what is there, and an edit
that takes the car away shows it. So the ground goes on level and looks like its surroundings; what stands above it goes
on downwards: a wall reaches the ground, and open air stays open.
"""

from __future__ import annotations

import torch
import torch.nn.functional as F
from torch import Tensor

from ...model.networks import frozen, shallow
from ...model.occupancy import OccupancyTrainer
from ...model.scene import SceneModel
from ...ops.constants import GROUND_CELL_M
from ...ops.field_values import signed_distances
from ...ops.padding import masked_mean, selected

REACH_M = 2.0
"""How high above the ground things are continued downwards: a van's height."""
_DRAWS, _POINTS = 2048, 192
_ALONG_M, _ACROSS_M = 6.0, 0.3
"""Where ground looks for what it may look like: a street goes on along the drive, and across it pavement
turns into road."""
_NEAR_M, _CANDIDATES = 6.0, 64
"""How far from a wall's foot the wall is looked for, and how many of LiDAR's returns are tried: the
nearest one is taken."""
_BAND_M = 0.3
"""Distances further than this from a surface are not compared."""
_CLEAR_M = (0.25, 1.0)
"""Where LiDAR hit the ground, and nothing between these heights above it, the ground is all there is."""


class UnobservedPrior:
    """Draws unobserved places and compares them with what is next to them.

    ``known_ground`` (C, 2) are the cells whose ground height can be trusted; ``still_boxes`` the poses (B, 4, 4), box
    to world, and sizes (B, 3) of actors that never move, whose inside the static field is never asked for; ``returns``
    (R, 3) what LiDAR hit outside of boxes, volume coordinates.
    """

    def __init__(
        self,
        model: SceneModel,
        occupancy: OccupancyTrainer,
        known_ground: Tensor,
        still_boxes: tuple[Tensor, Tensor] | None,
        returns: Tensor,
    ) -> None:
        self.model, self.occupancy, self.known_ground, self.still_boxes = model, occupancy, known_ground, still_boxes
        self.tables_alone = _with_tables_alone(model)
        returns = returns.to(known_ground.device)
        height = (returns - model.ground.under(returns))[:, 2]
        self.standing = returns[model.ground.above(returns)]
        self.standing = self.standing[self.standing[:, 0].argsort()]
        self.along = self.standing[:, 0].contiguous()
        stands = self._columns(returns[(height > _CLEAR_M[0]) & (height < _CLEAR_M[1])])
        lies = self._columns(returns[height.abs() < _CLEAR_M[0]])
        self.clear = (lies & (F.max_pool2d(stands[None].float(), 3, stride=1, padding=1)[0] == 0)).view(-1)

    def _columns(self, x: Tensor) -> Tensor:
        """Columns of voxels (X, Y) bool in which points (N, 3) lie."""
        shape = self.model.occupancy.values.shape
        out = torch.zeros(shape[0] * shape[1], dtype=torch.bool, device=x.device)
        out[self.model.occupancy.cells(x) // shape[2]] = True
        return out.view(shape[0], shape[1])

    def loss(self, generator: torch.Generator | None) -> Tensor:
        """Mean disagreement of unobserved places with their surroundings."""
        total, model = self.model.ground.heights.new_zeros(()), self.tables_alone
        if len(self.known_ground):
            total = total + self._aloft(model, generator) + self._on_ground(model, generator)
        if len(self.standing):
            total = total + self._appearance_of_returns(model, generator)
        if self.still_boxes is not None:
            total = total + self._under_boxes(model, *self.still_boxes, generator)
        return total

    def _known_places(self, generator: torch.Generator | None) -> Tensor:
        """Points (N, 3) of known ground."""
        device = self.known_ground.device
        cells = self.known_ground[torch.randint(len(self.known_ground), (_DRAWS,), generator=generator, device=device)]
        place = (cells + torch.rand(_DRAWS, 2, generator=generator, device=device)) * GROUND_CELL_M
        return self.model.ground.under(place)

    def _aloft(self, model: SceneModel, generator: torch.Generator | None) -> Tensor:
        """Return the loss that continues geometry above unobserved places downwards, and that requires free space close
        over clear ground."""
        device = self.known_ground.device
        x = self._known_places(generator)
        low = torch.arange(len(x), device=device) % 2 == 0
        reach_m = torch.where(low, _CLEAR_M[1] / 2, REACH_M)
        height = reach_m * torch.rand(len(x), generator=generator, device=device)
        x = x + F.pad(height[:, None], (2, 0))
        column = model.occupancy.cells(x) // model.occupancy.values.shape[2]
        clear = low & self.clear[column] & ~self.occupancy.in_view(x)
        pick, there = selected(clear | (~low & self.occupancy.unobserved(x)), 2 * _POINTS)
        x, height, clear = x[pick], height[pick], clear[pick]
        s = model.static.signed_distance(x)
        with torch.no_grad():
            above = x + F.pad(0.1 + 0.5 * torch.rand(len(x), 1, generator=generator, device=device), (2, 0))
            expected = torch.where(clear, height, torch.minimum(model.static.signed_distance(above), height))
        bands = s.clamp(-_BAND_M, _BAND_M), expected.clamp(-_BAND_M, _BAND_M)
        return masked_mean(F.smooth_l1_loss(*bands, beta=0.05, reduction="none"), there)

    def _on_ground(self, model: SceneModel, generator: torch.Generator | None) -> Tensor:
        """Ground that no image shows looks like ground along the street."""
        device = self.known_ground.device
        x = self._known_places(generator)
        pick, there = selected(~self.occupancy.in_view(x), _POINTS)
        x = x[pick]
        values, appearance = model.static(x)
        way = 2 * torch.rand(len(x), 2, generator=generator, device=device) - 1
        way = torch.stack([_ALONG_M * way[:, 0], _ACROSS_M * way[:, 1]], -1)
        alike = self._alike(model, appearance, model.ground.under(x[:, :2] + way), there, generator)
        return masked_mean(signed_distances(values).abs(), there) + alike

    def _appearance_of_returns(self, model: SceneModel, generator: torch.Generator | None) -> Tensor:
        """Returns above the ground that no image shows get the appearance of returns near by that one shows."""
        standing, device = self.standing, self.standing.device
        x = standing[torch.randint(len(standing), (_DRAWS,), generator=generator, device=device)]
        pick, there = selected(~self.occupancy.in_view(x), _POINTS)
        x = x[pick]
        first = torch.searchsorted(self.along, x[:, 0] - _NEAR_M)
        count = torch.searchsorted(self.along, x[:, 0] + _NEAR_M) - first
        draw = torch.rand(len(x), _CANDIDATES, generator=generator, device=device)
        other = standing[first[:, None] + (draw * count[:, None]).long().clamp_max(count[:, None] - 1)]
        away = (other - x[:, None]).norm(dim=-1)
        away = torch.where(self.occupancy.in_view(other.view(-1, 3)).view(away.shape), away, torch.inf)
        nearest, which = away.min(1)
        other, there = other[torch.arange(len(x), device=device), which], there & (nearest < _NEAR_M)
        return self._alike(model, model.static(x)[1], other, there, generator)

    def _alike(
        self, model: SceneModel, appearance: Tensor, at: Tensor, there: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """Mean difference of features (N, F) from those at points (N, 3), over those ``there`` (N,) that some image shows.

        Unobserved points are left out: if they copied each other, their appearance would drift.
        """
        with torch.no_grad():
            _, wanted = model.static(at)
        return masked_mean(self._unlike(model, appearance, wanted, generator), there & self.occupancy.in_view(at))

    def _unlike(
        self, model: SceneModel, appearance: Tensor, wanted: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """Differences (N,) of features (N, F): of their colours from random directions, and of the features
        themselves, for LiDAR.

        A place learns from many others. The mean of two colours is a colour between them; the mean of two
        features may mean any.
        """
        directions = torch.randn(len(appearance), 3, generator=generator, device=appearance.device)
        directions = F.normalize(torch.cat([directions[:, :2], -directions[:, 2:].abs()], -1), dim=-1).repeat(2, 1)
        both = torch.cat([appearance, wanted])
        camera = torch.full((len(both),), -1, device=appearance.device)
        colour = model.camera_decoder(
            model.ray_head(model.directed(both, directions), directions, camera)[:, :, None, None]
        )
        a, b = colour.mean((2, 3)).view(2, -1, 3)
        return (a - b.detach()).abs().mean(-1) + 0.02 * F.smooth_l1_loss(appearance, wanted, reduction="none").mean(-1)

    def _under_boxes(
        self, model: SceneModel, poses: Tensor, sizes: Tensor, generator: torch.Generator | None
    ) -> Tensor:
        """Under a box that never moves nobody saw the ground: nothing above it, and the appearance of
        its surroundings."""
        device, n = poses.device, _POINTS
        which = torch.randint(len(poses), (n,), generator=generator, device=device)
        unit = torch.rand(n, 3, generator=generator, device=device) - 0.5

        def place(local: Tensor) -> Tensor:
            world = torch.einsum("nij,nj->ni", poses[which][:, :3, :3], local) + poses[which][:, :3, 3]
            return model.frame.points(world)

        inside = place(unit * sizes[which])
        on_ground = model.ground.under(inside)
        s = model.static.signed_distance(inside)
        expected = (inside - on_ground)[:, 2].clamp(-_BAND_M, _BAND_M)
        height = F.smooth_l1_loss(s.clamp(-_BAND_M, _BAND_M), expected, beta=0.05)
        # the nearer long side, and a little beyond it
        side = torch.sign(unit[:, 1]) * (
            0.5 * sizes[which][:, 1] + 0.2 + 0.8 * torch.rand(n, generator=generator, device=device)
        )
        beyond = place(torch.stack([unit[:, 0] * sizes[which][:, 0], side, unit[:, 2] * 0], -1))
        beyond = model.ground.under(beyond)
        values, appearance = model.static(on_ground)
        everywhere = torch.ones(n, dtype=torch.bool, device=device)
        alike = self._alike(model, appearance, beyond, everywhere, generator)
        return height + signed_distances(values).abs().mean() + alike

    @torch.no_grad()
    def continued(self) -> Tensor:
        """Unobserved voxels (M,), flat numbers, under something that was seen: it goes on down to the ground.

        Voxels decide, not the field: where nobody looked it has surfaces of its own making.
        """
        model, device = self.model, self.known_ground.device
        voxel, shape = model.config.voxel_m, model.occupancy.values.shape
        corner = torch.arange(0, GROUND_CELL_M, voxel, device=device)
        place = (
            (self.known_ground * GROUND_CELL_M)[:, None] + torch.cartesian_prod(corner, corner) + voxel / 4
        ).reshape(-1, 2)
        column = model.occupancy.cells(model.ground.under(place)).unique()
        ground, levels = column % shape[2], round(REACH_M / voxel)
        seen, shown = self.occupancy.seen, self.occupancy.shown()
        goes_on = shown[column - ground + (ground + levels).clamp_max(shape[2] - 1)]
        cells = []
        for level in reversed(range(levels)):
            cell = column - ground + (ground + level).clamp_max(shape[2] - 1)
            below = goes_on & ~seen[cell]
            cells.append(cell[below])
            goes_on = below | shown[cell]
        return torch.cat(cells).unique()


def _with_tables_alone(model: SceneModel) -> SceneModel:
    """The model, of which only the tables of places learn: through networks that all places share, appearances and
    their models would grow together without end."""
    out = shallow(model)
    out.static = shallow(model.static)
    out.static.network = frozen(model.static.network)
    for name in ("ray_head", "camera_decoder", "colour_head", "sample_head"):
        if name in model._modules:
            out._modules[name] = frozen(getattr(model, name))
    return out
