"""What nobody saw goes on from above and beside; what was seen is left alone."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from unisim_blender.core.model.decode import CameraDecoder
from unisim_blender.core.model.occupancy import OccupancyTrainer
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.presets import preset
from unisim_blender.core.training.losses.unobserved import UnobservedPrior

GROUND_M = 2.0
WALL_X_M = 6.0
NOTHING = torch.zeros(0, 3)


@pytest.fixture
def model() -> SceneModel:
    """A volume of 10 m, its ground at 2 m, and a static field that is a wall in x above 3 m and nothing lower."""
    torch.manual_seed(0)
    model = SceneModel(preset("tiny").model, Volume(np.eye(4), np.full(3, 10.0)), (), ())
    model.ground.heights.fill_(GROUND_M)
    model.occupancy.values.fill_(255)
    return model


def learn(model: SceneModel, unobserved: UnobservedPrior, teach: bool, steps: int = 120) -> None:
    generator = torch.Generator().manual_seed(0)
    optimiser = torch.optim.Adam(model.static.parameters(), lr=1e-2)
    for _ in range(steps):
        x = torch.rand(1024, 3, generator=generator) * 10
        x[:, 2] = GROUND_M + 1.2 + x[:, 2] / 10 * 2
        wanted = (WALL_X_M - x[:, 0]).clamp(-0.3, 0.3)
        loss = (model.static.signed_distance(x) - wanted).abs().mean()
        if teach:
            loss = loss + unobserved.loss(generator)
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()


def test_a_wall_that_was_seen_above_goes_down_to_the_ground(model: SceneModel) -> None:
    occupancy = OccupancyTrainer(model.occupancy)
    cells = torch.as_tensor(np.argwhere(np.ones((10, 10), bool))).float()
    unobserved = UnobservedPrior(model, occupancy, cells, None, NOTHING)
    learn(model, unobserved, teach=True)
    y = torch.linspace(1, 9, 50)
    low = torch.stack([torch.full_like(y, 5.0), y, torch.full_like(y, GROUND_M + 0.6)], -1)
    behind = low + torch.tensor([2.0, 0, 0])
    with torch.no_grad():
        free, solid = model.static.signed_distance(low), model.static.signed_distance(behind)
        ground = model.static.signed_distance(low - torch.tensor([0, 0, 0.6]))
    assert float(free.median()) > 0.15 and float(solid.median()) < -0.15
    assert float(ground.abs().median()) < 0.1


def test_haze_is_freed_and_a_surface_between_samples_stays(model: SceneModel) -> None:
    """Rays along x: some of each stops in a haze at 2 m, most of it about a wall at 6.25 m, at two samples of it."""
    model.occupancy.values.fill_(100)
    occupancy = OccupancyTrainer(model.occupancy)
    occupancy.visited[:] = True
    occupancy.score.fill_(0.5)
    x = torch.tensor([2.1, 2.2, 2.7, 6.05, 6.2, 6.45])
    points = torch.stack([x, torch.full_like(x, 5.25), torch.full_like(x, 5.25)], -1).repeat(4, 1, 1)
    stops = torch.tensor([0.12, 0.1, 0.05, 0.2, 0.25, 0.0]).repeat(4, 1)
    front = torch.cat([torch.ones(4, 1), 1 - stops.cumsum(1)[:, :-1]], 1)
    cells = model.occupancy.cells(points[0])
    values = model.occupancy.values.view(-1)
    occupancy.note_stopped(points, stops, front)
    occupancy.free_unshown()
    assert (values[cells] > 0).all(), "four rays tell nothing yet"
    occupancy.note_stopped(points, stops, front)
    occupancy.free_unshown()
    assert (values[cells] > 0).tolist() == [False, False, False, True, True, True]
    assert int((values == 0).sum()) == 2, "no ray looked into the others"


def test_voxels_with_returns_stay_where_rays_pass(model: SceneModel) -> None:
    model.occupancy.values.fill_(100)
    occupancy = OccupancyTrainer(model.occupancy)
    occupancy.visited[:] = True
    points = torch.tensor([[0.25, 5.25, 5.25], [1.25, 5.25, 5.25], [2.25, 5.25, 5.25]])
    hit, beside, open_air = cells = model.occupancy.cells(points)
    occupancy.add_evidence(cells[:1], cells[1:2], cells[:0])
    for _ in range(8):
        occupancy.note_stopped(points[None], torch.full((1, 3), 0.2), torch.ones(1, 3))
    occupancy.score.fill_(0.5)
    occupancy.free_unshown()
    values = model.occupancy.values.view(-1)
    assert values[hit] > 0 and values[beside] > 0 and values[open_air] == 0


def test_voxels_under_a_wall_stay_and_hidden_air_is_free(model: SceneModel) -> None:
    """Seen: a wall from 1 m above the ground, the air beside it, and a crown 3 m up. Below 1 m nobody looked."""
    model.occupancy.values.fill_(20)
    occupancy = OccupancyTrainer(model.occupancy)
    occupancy.score.fill_(0.5)
    everywhere = torch.cartesian_prod(*[torch.arange(0.25, 10, 0.5)] * 3)
    above = everywhere[everywhere[:, 2] > GROUND_M + 1]
    wall, crown = (above[:, 0] - 6.25).abs() < 0.1, (above[:, 0] < 3) & (above[:, 2] > GROUND_M + 3)
    ones = torch.ones(len(above))
    for _ in range(300):
        occupancy.update(above, (wall | crown).float(), ones, prune=True, settled=True, camera=True)
    occupancy.free_unshown()
    unobserved = UnobservedPrior(
        model, occupancy, torch.cartesian_prod(torch.arange(10.0), torch.arange(10.0)), None, NOTHING
    )
    occupancy.free_unobserved(torch.zeros_like(occupancy.seen), unobserved.continued)
    low = everywhere[(everywhere[:, 2] > GROUND_M) & (everywhere[:, 2] < GROUND_M + 1)]
    alive = model.occupancy.values.view(-1)[model.occupancy.cells(low)] > 0
    assert torch.equal(alive, (low[:, 0] - 6.25).abs() < 0.1), "the wall's foot and nothing else"
    kept = model.occupancy.values.view(-1)[model.occupancy.cells(above)] > 0
    assert torch.equal(kept, wall | crown), "what was seen is as it was"


def test_what_was_looked_through_is_not_continued(model: SceneModel) -> None:
    model.occupancy.values.fill_(20)
    occupancy = OccupancyTrainer(model.occupancy)
    top = torch.tensor([[6.25, 5.25, GROUND_M + 2.25]])
    occupancy.update(top, torch.ones(1), torch.ones(1), prune=True, settled=True, camera=True)
    occupancy.free_unshown()
    unobserved = UnobservedPrior(model, occupancy, torch.tensor([[6.0, 5.0]]), None, NOTHING)
    through = torch.zeros_like(occupancy.seen)
    through[model.occupancy.cells(top - torch.tensor([0, 0, 1.0]))] = True
    occupancy.free_unobserved(through, unobserved.continued)
    column = top - torch.tensor([0, 0, 0.5]) * torch.arange(5)[:, None]
    alive = model.occupancy.values.view(-1)[model.occupancy.cells(column)] > 0
    assert alive.tolist() == [True, True, False, False, False]


def test_what_was_seen_is_left_alone(model: SceneModel) -> None:
    occupancy = OccupancyTrainer(model.occupancy)
    everywhere = torch.cartesian_prod(*[torch.arange(0.25, 10, 0.5)] * 3)
    ones = torch.ones(len(everywhere))
    occupancy.update(everywhere, ones, ones, prune=False, settled=False, camera=True)
    assert bool(occupancy.unobserved(everywhere).all())
    occupancy.update(everywhere, ones, torch.full_like(ones, 0.1), prune=False, settled=True, camera=True)
    assert bool(occupancy.unobserved(everywhere).all())  # behind something
    occupancy.update(everywhere, ones, ones, prune=False, settled=True, camera=True)
    assert not bool(occupancy.unobserved(everywhere).any())
    unobserved = UnobservedPrior(model, occupancy, torch.zeros(1, 2), None, NOTHING)
    assert len(unobserved.continued()) == 0
    assert float(unobserved.loss(torch.Generator().manual_seed(0))) == 0.0


def test_without_known_ground_nothing_is_continued(model: SceneModel) -> None:
    unobserved = UnobservedPrior(model, OccupancyTrainer(model.occupancy), torch.zeros(0, 2), None, NOTHING)
    assert float(unobserved.loss(torch.Generator().manual_seed(0))) == 0.0 and len(unobserved.continued()) == 0


@pytest.mark.parametrize("teach", (True, False))
def test_lidar_sees_no_looks(model: SceneModel, teach: bool) -> None:
    """A beam shows where something is, not how it looks: that is as near by, where an image shows it."""
    occupancy = OccupancyTrainer(model.occupancy)
    everywhere = torch.cartesian_prod(*[torch.arange(0.25, 10, 0.5)] * 3)
    ones = torch.ones(len(everywhere))
    occupancy.update(everywhere, ones, ones, prune=False, settled=True, camera=False)
    assert not bool(occupancy.unobserved(everywhere).any()) and not bool(occupancy.in_view(everywhere).any())
    high = everywhere[everywhere[:, 2] > GROUND_M + 1]
    occupancy.update(high, ones[: len(high)], ones[: len(high)], prune=False, settled=True, camera=True)
    assert bool(occupancy.in_view(high).all())
    y = torch.linspace(1, 9, 40)
    foot = torch.stack([torch.full_like(y, WALL_X_M), y, torch.full_like(y, GROUND_M + 0.7)], -1)
    wall = torch.cat([foot + torch.tensor([0, 0, up]) for up in (0.6, 1.2, 1.8)])
    unobserved = UnobservedPrior(model, occupancy, torch.zeros(0, 2), None, torch.cat([foot, wall]))
    wanted = torch.linspace(-1, 1, model.config.features)
    assert isinstance(model.camera_decoder, CameraDecoder)
    with torch.no_grad():
        model.camera_decoder.last.weight.mul_(1000)  # colours far enough apart

    def apart() -> float:
        """The mean difference between the colours of the foot and of the wall above it, looked at from the side."""
        with torch.no_grad():
            appearances = torch.cat([model.static(foot)[1], model.static(wall[:40])[1]])
            directions = torch.tensor([[1.0, 0, 0]]).expand(len(appearances), 3)
            features = model.ray_head(appearances, directions, torch.full((len(appearances),), -1))
            colour = model.camera_decoder(features[:, :, None, None]).mean((2, 3))
        return float((colour[:40] - colour[40:]).abs().mean())

    with torch.no_grad():
        model.static.grid.table.uniform_(-0.3, 0.3)
    generator, optimiser = torch.Generator().manual_seed(0), torch.optim.Adam([model.static.grid.table], lr=1e-2)
    for _ in range(200):
        loss = (model.static(wall)[1] - wanted).square().mean()
        optimiser.zero_grad()
        (loss + unobserved.loss(generator) if teach else loss).backward()
        optimiser.step()
    assert apart() < 0.01 if teach else apart() > 0.03


def test_over_clear_ground_that_no_image_shows_there_is_nothing(model: SceneModel) -> None:
    occupancy = OccupancyTrainer(model.occupancy)
    cells = torch.as_tensor(np.argwhere(np.ones((10, 10), bool))).float()
    axis = torch.arange(0.25, 9, 0.5)
    ground = torch.cat([torch.cartesian_prod(axis, axis), torch.full((len(axis) ** 2, 1), GROUND_M)], -1)
    bin_ = torch.tensor([[2.25, 2.25, GROUND_M + 0.6]])
    unobserved = UnobservedPrior(model, occupancy, cells, None, torch.cat([ground, bin_]))
    clear = torch.zeros(20, 20, dtype=torch.bool)
    clear[:18, :18] = True
    clear[3:6, 3:6] = False
    assert torch.equal(unobserved.clear.view(20, 20), clear), "where a beam met the ground, and nothing stands"
    learn(model, unobserved, teach=True)
    x = torch.rand(200, 3) * torch.tensor([3.0, 3, 0.3]) + torch.tensor([5.5, 5.5, GROUND_M + 0.12])
    with torch.no_grad():
        error = (model.static.signed_distance(x) - (x[:, 2] - GROUND_M).clamp_max(0.3)).abs()
    assert float(error.median()) < 0.08


def test_only_tables_learn_from_hidden_places(model: SceneModel) -> None:
    cells = torch.as_tensor(np.argwhere(np.ones((10, 10), bool))).float()
    unobserved = UnobservedPrior(
        model, OccupancyTrainer(model.occupancy), cells, (torch.eye(4)[None], torch.full((1, 3), 2.0)), NOTHING
    )
    unobserved.loss(torch.Generator().manual_seed(0)).backward()
    assert all(p.grad is None and p.requires_grad for p in model.static.network.parameters())
    assert model.static.grid.table.grad is not None and bool((model.static.grid.table.grad != 0).any())
