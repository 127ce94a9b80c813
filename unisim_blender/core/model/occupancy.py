"""Occupancy of the volume's voxels: seeded by LiDAR, then updated by the weights of training's samples."""

from __future__ import annotations

from collections.abc import Callable

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ..geometry import FloatArray
from ..ops.devices import zeros_on_demand
from ..ops.propose import Voxels
from .shapes import cells_of

FREE, UNKNOWN, BESIDE, HIT = 0, 20, 254, 255
"""Initial values of voxels: free, unknown, next to a LiDAR return, and with a return."""
_SCORE_DECAY = 0.97
_PRUNE_SCORE = 0.004
_MIN_HIT_SCORE = 64
_MIN_TRANSMITTANCE = 0.2
"""Smallest transmittance before a sample at which it counts as a look into its voxel."""
_MIN_SURFACE_SCORE = 0.08
"""Smallest score of a voxel with a surface. Scores start just below it, at UNKNOWN / 255, and rise with samples'
weights."""
_MIN_RAYS = 8
"""Smallest number of rays that must have looked into a voxel before the largest fraction of a ray that stops there
decides whether the voxel holds a surface."""
_SURFACE_STOP_FRACTION = 0.3
"""Smallest stop fraction of some ray in a voxel that holds a surface."""
_SURFACE_STOP_FRACTION_BESIDE = 0.1
"""Smallest stop fraction next to a LiDAR return, where surfaces are likely."""


class Occupancy(nn.Module):
    """The voxels, stored as one byte each."""

    def __init__(self, size_m: FloatArray, voxel_m: float) -> None:
        super().__init__()
        self.voxel_m = voxel_m
        self.register_buffer("values", torch.full(cells_of(size_m, voxel_m), UNKNOWN, dtype=torch.uint8))
        self.register_buffer("lower", torch.zeros(3), persistent=False)

    values: Tensor
    lower: Tensor

    @property
    def voxels(self) -> Voxels:
        """Voxels in the form that `propose.propose` reads."""
        return Voxels(self.values, self.lower, self.voxel_m)

    def cells(self, x: Tensor) -> Tensor:
        """Return flat voxel numbers (N,) of points (N, 3), volume coordinates; points outside have the nearest
        voxel's."""
        sizes = self.values.shape
        i, j, k = (torch.floor(x[:, a] / self.voxel_m).long().clamp_(0, size - 1) for a, size in enumerate(sizes))
        return i.mul_(sizes[1]).add_(j).mul_(sizes[2]).add_(k)


class OccupancyTrainer:
    """Updates the voxels by the weights of samples: a voxel whose samples have no weight for long is free."""

    def __init__(self, occupancy: Occupancy) -> None:
        self.occupancy = occupancy
        flat = occupancy.values.view(-1)
        self.score = flat / 255
        self.hit = flat >= BESIDE
        self.beside = flat == BESIDE
        self.visited, self.seen, self.viewed = (zeros_on_demand(flat.shape, torch.bool, flat.device) for _ in range(3))
        self.passed = flat == FREE
        self.stopped = zeros_on_demand(flat.shape, device=flat.device)
        self.looks = zeros_on_demand(flat.shape, torch.int32, flat.device)
        self._most = zeros_on_demand(flat.shape, device=flat.device)

    @torch.no_grad()
    def update(
        self,
        x: Tensor,
        weight: Tensor,
        before: Tensor,
        prune: bool,
        settled: bool,
        camera: bool,
        there: Tensor | None = None,
    ) -> None:
        """Update the voxels by samples at x (N, 3), volume coordinates, with weights (N,) and transmittances before
        them (N,); by those alone that are ``there`` (N,), where that is given.

        ``prune`` frees voxels that show nothing; ``settled`` says that surfaces hide what is behind them by now;
        ``camera`` that an image showed them, not LiDAR.
        """
        assert weight.shape == before.shape == x.shape[:1], (x.shape, weight.shape, before.shape)
        values = self.occupancy.values.view(-1)
        cells = self.occupancy.cells(x)
        if there is not None:
            # samples that are not there look again, without weight, into a voxel that one which is looks into
            cells = torch.where(there, cells, cells.index_select(0, there.to(torch.uint8).argmax()[None]))
            weight, before = torch.where(there, weight, 0.0), torch.where(there, before, 0.0)
        # all samples of a voxel find and write the same there, in whatever order
        if settled:
            looked = before > _MIN_TRANSMITTANCE
            into = torch.where(looked, cells, cells.index_select(0, looked.to(torch.uint8).argmax()[None]))
            for marks in (self.seen, self.viewed) if camera else (self.seen,):
                marks[into] = marks[into] | looked.any()
        # of voxels without samples the numbers are old
        best = self._most.index_fill_(0, cells, 0.0).scatter_reduce_(0, cells, weight, "amax")[cells]
        hit = self.hit[cells]
        self.visited.index_fill_(0, cells, True)
        score = torch.maximum(self.score[cells] * _SCORE_DECAY, best.clamp_max(1))
        self.score[cells] = score
        value = (score * 4).clamp_max(1) * 255
        value = torch.where(hit, value.clamp_min(_MIN_HIT_SCORE), value.clamp_min(4.0))
        if prune:
            value = torch.where((score < _PRUNE_SCORE) & ~hit, torch.zeros_like(value), value)
        # what was pruned stays so
        alive = values[cells] > 0
        values[cells] = torch.where(alive, value, torch.zeros_like(value)).to(torch.uint8)

    @torch.no_grad()
    def note_stopped(self, x: Tensor, weight: Tensor, before: Tensor) -> None:
        """Note the largest fraction of a ray that stops in each voxel, by samples x (R, K, 3), volume coordinates, in
        order along the rays, with weights (R, K) and transmittances (R, K) before them.

        A surface's weight is spread over the samples around it, so those of a ray in the same voxel are added.
        """
        assert weight.shape == before.shape == x.shape[:2], (x.shape, weight.shape, before.shape)
        cells = self.occupancy.cells(x.reshape(-1, 3)).view(weight.shape)
        enters = F.pad(cells[:, 1:] != cells[:, :-1], (1, 0), value=True).flatten()
        passages, cells = enters.cumsum(0) - 1, cells.flatten()
        stopped = torch.zeros_like(weight).flatten().index_add_(0, passages, weight.flatten())
        self.stopped.scatter_reduce_(0, cells, stopped[passages], "amax")
        looked = enters & (before.flatten() > _MIN_TRANSMITTANCE)
        self.looks.index_add_(0, cells, looked.to(torch.int32))

    @torch.no_grad()
    def add_evidence(self, hit: Tensor, beside: Tensor, passed: Tensor) -> None:
        """Update the voxels by LiDAR rays that are read during training, as if they had seeded the voxels.

        Flat numbers (N,) of the voxels in which a return lies, of those round one, and of those that rays only passed.
        """
        values = self.occupancy.values.view(-1)
        for cells, value in ((passed, FREE), (beside, BESIDE), (hit, HIT)):
            # a return that is known, or one in the voxel itself, counts for more
            cells = cells[~self.hit[cells] | (self.beside[cells] & (value == HIT))]
            values[cells], self.score[cells] = value, value / 255
            self.hit[cells], self.beside[cells], self.passed[cells] = value >= BESIDE, value == BESIDE, value == FREE

    @torch.no_grad()
    def unobserved(self, x: Tensor) -> Tensor:
        """Return which points (N, 3), volume coordinates, lie where no ray looked, in voxels that are not free: (N,)
        bool."""
        cells = self.occupancy.cells(x)
        return ~self.seen[cells] & (self.occupancy.values.view(-1)[cells] > FREE)

    @torch.no_grad()
    def free_unshown(self) -> None:
        """Free the voxels that show nothing: those without a LiDAR return that no sample of a ray was placed in, or
        whose samples never had weight, and those that rays only lose a part of themselves in. Left as they are, they
        would be rendered as fog, more of it the closer the samples are."""
        values = self.occupancy.values.view(-1)
        values[~self.hit & (~self.visited | (self.score < _MIN_SURFACE_SCORE))] = FREE
        values[self.beside & (~self.visited | (self.score < _PRUNE_SCORE))] = FREE
        known = self.looks >= _MIN_RAYS
        values[known & ~self.hit & (self.stopped < _SURFACE_STOP_FRACTION)] = FREE
        values[known & self.beside & (self.stopped < _SURFACE_STOP_FRACTION_BESIDE)] = FREE

    @torch.no_grad()
    def free_unobserved(self, through: Tensor, continued: Callable[[], Tensor]) -> None:
        """Free the voxels that no ray of the training has looked into, except those with a LiDAR return.

        ``through`` (V,) bool are voxels that rays of images pass on their way to a surface. These count as looked into,
        and so do those that LiDAR beams passed: free voxels get no samples, so their samples cannot tell.
        ``continued`` is called afterwards and returns numbers (M,) of voxels, in the flattened array, that are occupied
        all the same: surfaces continued to where nobody looked.
        """
        values = self.occupancy.values.view(-1)
        self.seen |= through | self.passed
        values[~self.seen & (self.beside | ~self.hit)] = FREE
        values[continued()] = HIT

    @torch.no_grad()
    def shown(self) -> Tensor:
        """Return the voxels (V,) bool that a ray looked into and that showed a surface."""
        return self.seen & (self.occupancy.values.view(-1) > FREE) & (self.score >= _MIN_SURFACE_SCORE)

    @torch.no_grad()
    def has_returns(self, x: Tensor) -> Tensor:
        """Return which points (N, 3), volume coordinates, lie in voxels with LiDAR returns: (N,) bool."""
        cells = self.occupancy.cells(x)
        return self.hit[cells] & ~self.beside[cells]

    @torch.no_grad()
    def in_view(self, x: Tensor) -> Tensor:
        """Return which points (N, 3), volume coordinates, some image shows: (N,) bool."""
        return self.viewed[self.occupancy.cells(x)]

    def state(self) -> dict[str, Tensor]:
        """Return the tensors that a checkpoint stores in addition to the voxels."""
        names = ("score", "hit", "beside", "visited", "seen", "viewed", "passed", "stopped", "looks")
        return {name: getattr(self, name) for name in names}

    def load_state(self, state: dict[str, Tensor]) -> None:
        for name, own in self.state().items():
            # former checkpoints: what "passed" says was known from the start, the others begin late
            if name in state or name not in ("passed", "stopped", "looks"):
                own.copy_(state[name])
