"""What LiDAR says about signed distances: zero where a beam came back, above zero where it passed."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import torch

from unisim_blender.core.fields.config import preset
from unisim_blender.core.fields.occupancy import OccupancyTrainer
from unisim_blender.core.fields.scene import SceneModel
from unisim_blender.core.fields.volume import Volume
from unisim_blender.core.strands import RayBatch
from unisim_blender.core.training.data import LidarBatch
from unisim_blender.core.training.shape import Shape

WALL_X_M = 7.0


def sweep(n: int = 512) -> LidarBatch:
    """Level beams along x, from x = 0, onto a wall."""
    rng = np.random.default_rng(0)
    origins = np.stack([np.zeros(n), rng.uniform(1, 9, n), rng.uniform(4, 8, n)], -1)
    directions = np.tile([1.0, 0, 0], (n, 1))
    rays = RayBatch(torch.tensor(origins).float(), torch.tensor(directions).float(), torch.zeros(n).double())
    ones = torch.ones(n)
    return LidarBatch(rays, WALL_X_M * ones, 0.5 * ones, torch.ones(n, dtype=torch.bool), ones)


@pytest.mark.parametrize("beams", (True, False))
def test_a_solid_that_beams_passed_through_goes(beams: bool) -> None:
    """It is opaque, so rays alone would never tell that something is behind it."""
    torch.manual_seed(0)
    model = SceneModel(preset("tiny"), Volume(np.eye(4), np.full(3, 10.0)), (), ())
    shape = Shape(model, OccupancyTrainer(model.occupancy), torch.zeros(0, 2))
    generator, optimiser = torch.Generator().manual_seed(0), torch.optim.Adam(model.static.parameters(), lr=1e-2)
    nothing: Any = SimpleNamespace(strands=[], static=None, feature=torch.zeros(1))
    for step in range(300):
        x = 10 * torch.rand(1024, 3, generator=generator)
        optimiser.zero_grad()
        if step < 150:
            wanted = torch.where((x[:, 0] > WALL_X_M - 2) & (x[:, 0] < WALL_X_M - 0.5), -0.4, 0.3)
            loss = (model.static.distance(x) - wanted).abs().mean()
        else:
            batch = sweep()
            if not beams:
                batch = LidarBatch(batch.rays, batch.depth_m, batch.intensity, torch.zeros_like(batch.returned), batch.weight)
            band, _ = shape.band(torch.zeros(0), nothing, batch, generator)
            loss = band + 0 * model.static.distance(x).sum()
        loss.backward()
        optimiser.step()
    with torch.no_grad():
        y = torch.linspace(2, 8, 60)
        solid = torch.stack([torch.full_like(y, WALL_X_M - 1.2), y, torch.full_like(y, 6.0)], -1)
        s = model.static.distance(solid)
    assert float(s.median()) > -0.05 if beams else float(s.median()) < -0.3
