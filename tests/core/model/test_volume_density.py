"""Densities as a NeRF has them: closed forms, along rays through media of known thickness, free space between."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from analytic_scene import Stage, analytic_scene, drive_of, still
from torch import Tensor
from whole_drive import whole_state

from unisim_blender.core.geometry import FloatArray, make_pose
from unisim_blender.core.ops.constants import EMPTY_LOG_DENSITY
from unisim_blender.core.ops.density import volume_intervals
from unisim_blender.core.ops.quantiles import refine_by_density
from unisim_blender.core.presets import preset
from unisim_blender.core.render.tracers.torch.median import median_depth
from unisim_blender.core.world.drive import Box

CONFIG = replace(preset("tiny").model, density="volume", light="fixed")
EYE = np.array([-20.0, 0, 1.6])
STARTS = EYE + np.linspace(0, 1, 64)[:, None] * np.array([1.0, 0, 0])
"""Means over many places: one ray's samples fall where they fall about an edge."""


def fog(density: float, *spans: tuple[float, float]) -> object:
    """A density between some x, as its logarithm; nothing elsewhere."""

    def logs(x: Tensor) -> Tensor:
        inside = torch.stack([(x[:, 0] >= a) & (x[:, 0] <= b) for a, b in spans]).any(0)
        return torch.where(
            inside, torch.full_like(x[:, 0], np.log(density)), torch.full_like(x[:, 0], EMPTY_LOG_DENSITY)
        )

    return logs


def staged(static: object, actors: dict[str, tuple[object, FloatArray]] | None = None, drive: object = None) -> Stage:
    """A scene whose voxels are occupied where it has a density, and next to that."""
    scene = analytic_scene(static, actors or {}, CONFIG)  # type: ignore[arg-type]
    shape, step = scene.occupancy.values.shape, CONFIG.voxel_m
    axes = (torch.arange(n) * step + step / 2 for n in shape)
    x = torch.stack(torch.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    there = (scene.static.log_density(x) > EMPTY_LOG_DENSITY).view(1, *shape).float()
    scene.occupancy.values.copy_(F.max_pool3d(there, 3, 1, 1)[0] * 255)
    return Stage(scene, drive or drive_of([]))  # type: ignore[arg-type]


def test_intervals_by_hand() -> None:
    """Densities 1 and 2 over 0.5 m and 1 m: depths of 0.5 and 2, weights at the far samples."""
    tau, share = volume_intervals(torch.tensor([[0.0, float(np.log(2))]]), torch.tensor([[0.5, 1.0]]))
    torch.testing.assert_close(tau, torch.tensor([[0.5, 2.0]]))
    torch.testing.assert_close(share, torch.tensor([[0.0, 1 - float(np.exp(-2.0))]]))
    assert bool(torch.isfinite(volume_intervals(torch.tensor([[-1e4, 1e4]]), torch.ones(1, 2))[0]).all())


def test_a_second_set_of_samples_goes_where_rays_stop() -> None:
    """All of a ray stops about the third of four quantiles: nearly all samples lie in its part of [0, 1]."""
    u = torch.tensor([[0.125, 0.375, 0.625, 0.875]])
    drawn = refine_by_density(u, torch.tensor([[0.0, 0.0, 50.0, 50.0]]), (torch.arange(100)[None] + 0.5) / 100)
    inside = (drawn > 0.5) & (drawn < 0.75)
    assert int(inside.sum()) >= 95 and bool((drawn.diff() > 0).all())
    even = refine_by_density(u, torch.zeros(1, 4), (torch.arange(100)[None] + 0.5) / 100)
    torch.testing.assert_close(even, (torch.arange(100)[None] + 0.5) / 100, atol=1e-5, rtol=0)


@pytest.mark.parametrize("gap_m", (0.0, 10.0))
def test_free_space_between_samples_has_no_density(gap_m: float) -> None:
    """Four metres of fog of 0.4 / m let exp(-1.6) through, in one piece or with a gap of ten metres, of which
    alone the density would stop all but exp(-4). A bit more than that, for an interval has its far end's
    density throughout."""
    traced = staged(fog(0.4, (0.0, 2.0), (2.0 + gap_m, 4.0 + gap_m))).trace(STARTS, [1.0, 0.05, 0.02], fine=20.0)
    length = 4 * np.linalg.norm([1.0, 0.05, 0.02])
    np.testing.assert_allclose(-traced.transmittance_after.log().mean(), 0.4 * length, rtol=0.15)


def test_a_wall_stops_rays_at_its_face() -> None:
    stage = staged(fog(200.0, (4.0, 8.0)))
    traced = stage.trace(EYE, [[1.0, 0, 0], [1.0, 0.2, 0.05]], fine=8.0)
    reach = 24 * np.linalg.norm([[1.0, 0, 0], [1.0, 0.2, 0.05]], axis=1)
    assert float(traced.opacity.min()) > 0.999
    np.testing.assert_allclose(traced.depth_m, reach, atol=0.15)
    np.testing.assert_allclose(median_depth(traced), reach, atol=0.15)


def test_an_actors_density_fills_its_box_and_clears_it_of_the_scenes() -> None:
    """A box of three metres of 0.5 / m, in a fog that it displaces above the ground."""
    size = np.array([3.0, 2.0, 2.0])
    car = still("car", [0, 0, 2.0], size)
    stage = staged(fog(0.3, (-1.5, 1.5)), {"car": (fog(0.5, (-9.0, 9.0)), size)}, drive_of([car]))
    np.testing.assert_allclose(
        stage.trace(EYE, [1.0, 0, 0], fine=16.0).transmittance_after, np.exp(-0.5 * 3), rtol=0.03
    )
    gone = replace(stage, drive=drive_of([], removals=whole_state(drive_of([]), drive_of([car])).removed_boxes))
    np.testing.assert_allclose(gone.trace(EYE, [1.0, 0, 0], fine=16.0).transmittance_after, 1, atol=1e-3)
    beside = replace(
        stage, drive=drive_of([], removals=(Box(make_pose(np.array([0, 9.0, 2]), np.array([1.0, 0, 0, 0])), size),))
    )
    np.testing.assert_allclose(
        -beside.trace(STARTS, [1.0, 0, 0], fine=16.0).transmittance_after.log().mean(), 0.3 * 3, rtol=0.08
    )
