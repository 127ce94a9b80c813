"""Median depths of rays through scenes that are known in closed form, and against a plain search along the ray."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from analytic_scene import Stage, analytic_scene, block, drive_of, empty, ground, sphere, still, union, wall

from unisim_blender.core.ops.field_values import signed_distances
from unisim_blender.core.ops.ray_segments import StaticSegments
from unisim_blender.core.ops.segment_trace import SegmentTrace
from unisim_blender.core.presets import preset
from unisim_blender.core.render.tracers.torch.ray_passes import median_depth

EYE = np.array([-20.0, 0.0, 1.6])


def searched(traced: SegmentTrace, ray: int) -> float:
    """Where the transmittance of one ray falls past half of what it loses: intervals cut into 2000
    pieces, in depth order."""
    beta = 30.0
    pieces = []
    for ray_segment in traced.ray_segments:
        assert isinstance(ray_segment, StaticSegments)
        for row in torch.nonzero(ray_segment.ray == ray)[:, 0].tolist():
            t, s = ray_segment.t[row].double(), signed_distances(ray_segment.values)[row].double()
            pieces.append((t[:1], torch.nn.functional.softplus(-beta * s[:1])))
            for k in range(1, len(t)):
                u = torch.linspace(0, 1, 2001, dtype=torch.float64)
                outside = torch.nn.functional.softplus(-beta * (s[k - 1] + u * (s[k] - s[k - 1])))
                pieces.append((t[k - 1] + (u[1:] + u[:-1]) / 2 * (t[k] - t[k - 1]), outside.diff().clamp_min(0)))
    t, tau = (torch.cat(part) for part in zip(*pieces, strict=True))
    order = torch.argsort(t, stable=True)
    left = torch.exp(-tau[order].cumsum(0))
    return float(t[order][int((left <= (1 + left[-1]) / 2).to(torch.uint8).argmax())])


@pytest.mark.parametrize("angle_deg", (60.0, 20.0, 5.0))
def test_median_on_a_plane(angle_deg: float) -> None:
    stage = Stage(analytic_scene(ground, {}, beta=60.0), drive_of([]))
    slope = np.radians(angle_deg)
    yaw = np.radians(np.arange(0, 360, 30))
    d = np.stack([np.cos(slope) * np.cos(yaw), np.cos(slope) * np.sin(yaw), np.full_like(yaw, -np.sin(slope))], -1)
    traced = stage.trace([0.0, 0, 1.2], d)
    np.testing.assert_allclose(median_depth(traced), 1.2 / np.sin(slope), rtol=3e-3)


def test_median_against_a_search() -> None:
    """One field on each ray, blurred: edges, grazing rays, rays that are stopped in part."""
    stage = Stage(analytic_scene(union(ground, wall(9.0), sphere([-4.0, 1.0, 1.5], 1.2)), {}, beta=30.0), drive_of([]))
    d = np.random.default_rng(0).normal([1, 0, -0.03], [0, 0.15, 0.06], (60, 3))
    traced = stage.trace(EYE, d, fine=2.0)
    expected = [searched(traced, ray) for ray in range(60)]
    np.testing.assert_allclose(median_depth(traced), expected, rtol=1e-3, atol=5e-3)


def test_a_median_between_two_intervals_is_their_border() -> None:
    """Rounding may leave the transmittance above the half behind one interval and below it before the next."""
    stage = Stage(analytic_scene(union(ground, wall(9.0)), {}, beta=30.0), drive_of([]))
    d = np.random.default_rng(0).normal([1, 0, -0.03], [0, 0.15, 0.06], (60, 3))
    traced = stage.trace(EYE, d, fine=2.0)
    ((segments, weights),) = traced.weighted()
    wanted = ((1 + traced.transmittance_after) / 2)[segments.ray][:, None]
    before = weights.transmittance_before
    crossed = (before > wanted) & (before * torch.exp(-segments.tau) <= wanted)
    short = torch.where(crossed, torch.log(before / wanted) - 1e-5, segments.tau)
    without = replace(traced, ray_segments=(replace(segments, tau=short),))
    expected = torch.zeros(60).index_put_((segments.ray[crossed.any(1)],), segments.t[crossed])
    assert (expected > 0).sum() > 40
    np.testing.assert_allclose(median_depth(without), expected)


def test_median_of_rays_that_are_stopped_in_part() -> None:
    stage = Stage(analytic_scene(sphere([-4.0, 0.0, 1.6], 2.0), {}, beta=30.0), drive_of([]))
    d = np.stack([np.full(40, 16.0), np.linspace(2.0, 2.25, 40), np.zeros(40)], -1)
    traced = stage.trace(EYE, d, fine=4.0)
    part = torch.nonzero((traced.opacity > 0.02) & (traced.opacity < 0.6))[:, 0].tolist()
    assert len(part) > 8
    expected = [searched(traced, ray) for ray in part]
    np.testing.assert_allclose(median_depth(traced)[part], expected, rtol=1e-3, atol=5e-3)


def test_between_an_edge_and_the_wall_behind_it_lies_nothing() -> None:
    size = np.array([2.0, 4.0, 4.0])
    stage = Stage(
        analytic_scene(wall(9.0), {"car": (block([1.0, 2.0, 2.0]), size)}, beta=20.0),
        drive_of([still("car", [0, 0, 1.6], size)]),
    )
    across = np.linspace(0.9, 1.1, 81) / 19.5
    traced = stage.trace(EYE, np.stack([np.ones(81), across, np.zeros(81)], -1))
    depth = median_depth(traced).numpy()
    mean = traced.depth_m.numpy()
    on_car, on_wall = np.abs(depth - 19.6) < 1.3, np.abs(depth - 29) < 0.3
    assert (on_car | on_wall).all() and on_car.sum() > 20 and on_wall.sum() > 20
    assert (np.abs(mean - 24) < 2).any(), "the mean lies on neither"


def test_a_veil_moves_the_mean_and_not_the_median() -> None:
    stage = Stage(
        analytic_scene(union(wall(9.0), lambda x: sphere([-10.0, 0, 1.6], 1.0)(x)), {}, beta=4.0), drive_of([])
    )
    traced = stage.trace(EYE, [1.0, 0.132, 0.0], fine=8.0)
    depth, mean = float(median_depth(traced)), float(traced.depth_m)
    exact = 29 * np.sqrt(1 + 0.132**2)
    assert exact - mean > 2 and abs(depth - exact) < 0.5


def test_where_nothing_is_met() -> None:
    stage = Stage(analytic_scene(sphere([0.0, 0, 1.6], 1.0), {}), drive_of([]))
    traced = stage.trace(EYE, [[-1.0, 0, 0], [0, 1, 0]], background=True)
    np.testing.assert_allclose(median_depth(traced), 0, atol=1e-6)


def test_the_background_model_counts() -> None:
    stage = Stage(analytic_scene(empty, {}), drive_of([]))
    features = stage.scene.config.features
    stage.scene.background.forward = lambda x: (torch.full_like(x[:, 0], 50.0), x.new_ones(len(x), features))  # type: ignore[method-assign]
    traced = stage.trace(EYE, [1.0, 0, 0], background=True)
    depth = float(median_depth(traced))
    assert depth == pytest.approx(float(traced.depth_m), rel=1e-4) and depth > 45


def test_a_ray_that_starts_inside_something_stops_at_once() -> None:
    stage = Stage(analytic_scene(wall(-21.0), {}), drive_of([]))
    stage.scene.occupancy.values.fill_(255)
    traced = stage.trace(EYE, [1.0, 0, 0])
    assert float(median_depth(traced)) == pytest.approx(float(traced.ray_segments[0].t[0, 0]))


def test_median_of_the_papers_density() -> None:
    config = replace(preset("tiny").model, density="unisim", unisim_step_m=0.2)
    stage = Stage(analytic_scene(wall(4.0), {}, config, beta=40.0), drive_of([]))
    depth = median_depth(stage.trace(EYE, [[1.0, 0, 0], [1.0, 0.1, 0]], fine=8.0))
    np.testing.assert_allclose(depth, [24, 24 * np.sqrt(1.01)], atol=0.3)
