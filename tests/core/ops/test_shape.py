"""What LiDAR says about signed distances: zero where a beam came back, above zero where it passed."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import torch
from torch import Tensor

from unisim_blender.core.model.occupancy import OccupancyTrainer
from unisim_blender.core.model.scene import SceneModel
from unisim_blender.core.model.volume import Volume
from unisim_blender.core.ops.composite import SegmentWeights
from unisim_blender.core.ops.field_values import SignedDistances
from unisim_blender.core.ops.ray_segments import ActorSegments, RayBatch, RaySegments
from unisim_blender.core.ops.segment_trace import SegmentTrace
from unisim_blender.core.presets import preset
from unisim_blender.core.training.batches.sweeps import LidarBatch
from unisim_blender.core.training.losses.shape import ShapeLosses

WALL_X_M = 7.0


def sweep(n: int = 512) -> LidarBatch:
    """Level beams along x, from x = 0, onto a wall."""
    rng = np.random.default_rng(0)
    origins = np.stack([np.zeros(n), rng.uniform(1, 9, n), rng.uniform(4, 8, n)], -1)
    directions = np.tile([1.0, 0, 0], (n, 1))
    rays = RayBatch(torch.tensor(origins).float(), torch.tensor(directions).float(), torch.zeros(n).double())
    ones = torch.ones(n)
    return LidarBatch(rays, WALL_X_M * ones, 0.5 * ones, torch.ones(n, dtype=torch.bool), ones)


def met(n: int, ray_segments: tuple[RaySegments, ...] = (), stop_m: float | None = None) -> SegmentTrace:
    """What n rays met: ray segments, and something that stopped them all at a distance, or nothing."""
    depth_m, opacity = torch.full((n,), stop_m or 0.0), torch.full((n,), 0.0 if stop_m is None else 1.0)
    weights = tuple(SegmentWeights(s.tau, s.tau, s.tau) for s in ray_segments)
    return SegmentTrace(
        torch.zeros(n, 1), depth_m, opacity, 1 - opacity, depth_m, opacity, ray_segments, weights, samples=0
    )


@pytest.mark.parametrize("beams", (True, False))
def test_a_solid_that_beams_passed_through_goes(beams: bool) -> None:
    """It is opaque, so rays alone would never tell that something is behind it."""
    torch.manual_seed(0)
    model = SceneModel(preset("tiny").model, Volume(np.eye(4), np.full(3, 10.0)), (), ())
    shape = ShapeLosses(model, OccupancyTrainer(model.occupancy), torch.zeros(0, 2))
    generator, optimiser = torch.Generator().manual_seed(0), torch.optim.Adam(model.static.parameters(), lr=1e-2)
    for step in range(300):
        x = 10 * torch.rand(1024, 3, generator=generator)
        optimiser.zero_grad()
        if step < 150:
            wanted = torch.where((x[:, 0] > WALL_X_M - 2) & (x[:, 0] < WALL_X_M - 0.5), -0.4, 0.3)
            loss = (model.static.signed_distance(x) - wanted).abs().mean()
        else:
            batch = sweep()
            if not beams:
                batch = LidarBatch(
                    batch.rays, batch.depth_m, batch.intensity, torch.zeros_like(batch.returned), batch.weight
                )
            band, _ = shape.sdf_band(torch.zeros(0), met(len(batch.rays)), batch, generator)
            loss = band + 0 * model.static.signed_distance(x).sum()
        loss.backward()
        optimiser.step()
    with torch.no_grad():
        y = torch.linspace(2, 8, 60)
        solid = torch.stack([torch.full_like(y, WALL_X_M - 1.2), y, torch.full_like(y, 6.0)], -1)
        s = model.static.signed_distance(solid)
    assert float(s.median()) > -0.05 if beams else float(s.median()) < -0.3


def box_ahead(size_m: tuple[float, float, float], beams: LidarBatch, depth_m: float) -> SegmentTrace:
    """What the first half of level beams meets of an upright box whose face stands 0.5 m nearer than
    where they come back."""
    n = len(beams.rays) // 2
    near = torch.full((n,), depth_m - 0.5)
    far = near + size_m[0]
    t = near[:, None] + (far - near)[:, None] * torch.linspace(0, 1, 5)
    across = torch.rand(n, 1, 2, generator=torch.Generator().manual_seed(1)).expand(n, 5, 2)
    points = torch.cat([((t - near[:, None]) / size_m[0])[..., None], across], -1)
    nothing = torch.zeros(n, 5)
    segments = ActorSegments(
        ray=torch.arange(n), t=t, features=nothing[..., None], tau=nothing, stop_fraction=nothing,
        values=SignedDistances(nothing), points=points, density="logistic", beta=torch.tensor(20.0), actor_set=0,
        actor=torch.zeros(n, dtype=torch.long), t_near=near, t_far=far, world_from_box=torch.eye(3).expand(n, 3, 3),
        size_m=torch.tensor([size_m]).expand(n, 3),
    )  # fmt: skip
    return met(len(beams.rays), (segments,))


SHELL_M = 0.06
FIELDS: dict[str, Callable[[Tensor], Tensor]] = {
    "solid": lambda behind: -behind,
    "shell": lambda behind: torch.where(behind < SHELL_M, -behind, torch.full_like(behind, 0.3)),
}
"""Distances by how far behind the return a point lies."""


@pytest.mark.parametrize(
    ("size_m", "reach_m"),
    (((4.0, 1.8, 1.5), 0.375), ((7.0, 2.4, 3.0), 0.4), ((0.8, 0.4, 0.4), 0.1), ((0.6, 0.9, 0.9), 0.15)),
)
@pytest.mark.parametrize("field", FIELDS)
def test_behind_a_return_an_actor_is_solid(field: str, size_m: tuple[float, float, float], reach_m: float) -> None:
    """As far as its size allows: a solid pays nothing, a shell what it lacks there, on average."""
    beams = sweep(4096)
    model = SceneModel(preset("tiny").model, Volume(np.eye(4), np.full(3, 40.0)), ("a",), ())
    model.ground.heights.fill_(-5)
    shape = ShapeLosses(model, OccupancyTrainer(model.occupancy), torch.zeros(0, 2))
    deepest = []

    def distance(tables: Tensor, x: Tensor, actor: Tensor) -> Tensor:
        behind = x[:, 0] * size_m[0] - 0.5
        deepest.append(float(behind.max()))
        return FIELDS[field](behind)

    model.actors.signed_distance = distance  # type: ignore[method-assign]
    model.static.signed_distance = lambda x: WALL_X_M - x[:, 0]  # type: ignore[method-assign]
    with torch.no_grad():
        band, (_, near) = shape.sdf_band(
            torch.zeros(0), box_ahead(size_m, beams, WALL_X_M), beams, torch.Generator().manual_seed(0)
        )
    assert int(near.sum()) == len(beams.rays) // 2, "returns in a box are none of the static field's"
    room_m = size_m[0] - 0.5
    assert max(deepest) == pytest.approx(min(reach_m, room_m), rel=0.01)
    # what is past the box is nobody's
    behind = torch.linspace(min(0.1, reach_m), reach_m, 10_001)
    lacks = torch.relu(FIELDS[field](behind) + 0.2 * behind.clamp_max(0.1)) * (behind < room_m)
    assert float(band) == pytest.approx(float(lacks.mean()), rel=0.05, abs=1e-6)


@pytest.mark.parametrize("room_m", (30.0, 0.2))
@pytest.mark.parametrize("field", FIELDS)
def test_behind_a_return_a_wall_is_solid(field: str, room_m: float) -> None:
    """For 0.3 m, if the volume goes on so far: the same sum, of a shell twice as thick, which the band
    about it misses."""
    beams = sweep(4096)
    model = SceneModel(preset("tiny").model, Volume(np.eye(4), np.array([WALL_X_M + room_m, 40, 40])), (), ())
    model.ground.heights.fill_(-5)
    shape = ShapeLosses(model, OccupancyTrainer(model.occupancy), torch.zeros(0, 2))
    model.static.signed_distance = lambda x: 2 * FIELDS[field]((x[:, 0] - WALL_X_M) / 2)  # type: ignore[method-assign]
    with torch.no_grad():
        band, _ = shape.sdf_band(torch.zeros(0), met(len(beams.rays)), beams, torch.Generator().manual_seed(0))
    behind = torch.linspace(0.1, 0.3, 10_001)
    lacks = torch.relu(2 * FIELDS[field](behind / 2) + 0.2 * behind.clamp_max(0.1)) * (behind < room_m)
    assert float(band) == pytest.approx(float(lacks.mean()), rel=0.05, abs=1e-6)


@pytest.mark.parametrize(
    ("stop_m", "ground_m", "low_m", "high_m"),
    (
        (None, -5.0, 3.0, 6.7),
        (WALL_X_M, -5.0, 3.0, 6.7),
        (5.0, -5.0, 5.0, 5.2),
        (6.6, -5.0, 6.6, 6.7),
        (5.0, 9.0, 3.0, 6.7),
    ),
)
def test_free_space_is_asked_for_where_a_ray_stops_too_early(
    stop_m: float | None, ground_m: float, low_m: float, high_m: float
) -> None:
    """Evenly over four metres where it does not, or comes back from the ground."""
    beams = sweep(4096)
    model = SceneModel(preset("tiny").model, Volume(np.eye(4), np.full(3, 40.0)), (), ())
    model.ground.heights.fill_(ground_m)
    shape = ShapeLosses(model, OccupancyTrainer(model.occupancy), torch.zeros(0, 2))
    asked: list[Tensor] = []

    def distance(x: Tensor) -> Tensor:
        asked.append(x[:, 0])
        return WALL_X_M - x[:, 0]

    model.static.signed_distance = distance  # type: ignore[method-assign]
    with torch.no_grad():
        shape.sdf_band(torch.zeros(0), met(len(beams.rays), stop_m=stop_m), beams, torch.Generator().manual_seed(0))
    (free,) = (x for x in asked if float(x.max()) < WALL_X_M - 0.29)
    assert len(free) == len(beams.rays)
    assert float(free.min()) == pytest.approx(low_m, abs=0.01) and float(free.max()) == pytest.approx(high_m, abs=0.01)


@pytest.mark.parametrize(("nearer_m", "high_m"), ((0.0, 6.85), (0.35, 6.85), (2.0, 6.5)))
def test_boxes_are_free_where_beams_passed(nearer_m: float, high_m: float) -> None:
    """Up to returns inside of it, all of it before those behind it; half of the places are where beams enter."""
    beams = sweep(8192)
    model = SceneModel(preset("tiny").model, Volume(np.eye(4), np.full(3, 40.0)), ("a",), ())
    model.ground.heights.fill_(-5)
    shape = ShapeLosses(model, OccupancyTrainer(model.occupancy), torch.zeros(0, 2))
    asked: list[Tensor] = []
    low_m, size_m = WALL_X_M - 0.5 - nearer_m, (2.0, 0.6, 0.6)

    def distance(tables: Tensor, x: Tensor, actor: Tensor) -> Tensor:
        asked.append(x[:, 0] * size_m[0] + low_m)
        return torch.full_like(x[:, 0], 0.05)

    model.actors.signed_distance = distance  # type: ignore[method-assign]
    model.static.signed_distance = lambda x: WALL_X_M - x[:, 0]  # type: ignore[method-assign]
    with torch.no_grad():
        trace = box_ahead(size_m, beams, WALL_X_M - nearer_m)
        band, _ = shape.sdf_band(torch.zeros(0), trace, beams, torch.Generator().manual_seed(0))
    passed = asked[0]
    assert len(passed) == len(beams.rays) // 2
    assert float(passed.min()) == pytest.approx(low_m, abs=0.01) and float(passed.max()) == pytest.approx(
        high_m, abs=0.01
    )
    at_face, evenly = (passed < low_m + 0.1).float().mean(), 0.1 / (high_m - low_m)
    assert float(at_face) == pytest.approx(0.5 + 0.5 * evenly, abs=0.03)
    if nearer_m > 1:
        assert float(band) == pytest.approx(0.5 * (0.15 - 0.05), rel=0.05)


def test_a_surface_is_held_as_closely_from_behind_as_from_before() -> None:
    """Returns that scatter about it move it to neither side: offsets are as dense on both."""
    model = SceneModel(preset("tiny").model, Volume(np.eye(4), np.full(3, 40.0)), (), ())
    shape = ShapeLosses(model, OccupancyTrainer(model.occupancy), torch.zeros(0, 2))
    offset = shape._offsets(100_000, torch.Generator().manual_seed(0), 0.3)
    near = offset[(offset != 0) & (offset.abs() < 0.09)]
    assert float((near > 0).float().mean()) == pytest.approx(0.5, abs=0.01)
    assert float(offset.min()) == pytest.approx(-0.09, abs=1e-3) and float(offset.max()) == pytest.approx(0.3, abs=1e-3)
    assert float((offset == 0).float().mean()) == pytest.approx(0.34, abs=0.01)
