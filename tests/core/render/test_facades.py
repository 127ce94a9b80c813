"""Façades: the large vertical planes of what views show."""

from __future__ import annotations

import numpy as np

from unisim_blender.core.geometry import FloatArray, transform_points
from unisim_blender.core.render.confidence import DepthView, around
from unisim_blender.core.render.facades import FOOT_M, fitted_facades, surfaces_of
from unisim_blender.core.sensors.rays import Rays

Surface = tuple[FloatArray, FloatArray]


def wall(start: tuple[float, float], toward_deg: float, length: float, height: float, noise: float = 0.02) -> Surface:
    """Return points on a wall that stands on the ground, and its normals."""
    rng, count = np.random.default_rng(1), int(length * height * 60)
    x, y = np.cos(np.radians(toward_deg)), np.sin(np.radians(toward_deg))
    along, up = rng.uniform(0, length, count), rng.uniform(0, height, count)
    normal = np.array([y, -x, 0])
    points = np.array([*start, 0]) + along[:, None] * [x, y, 0] + up[:, None] * [0, 0, 1]
    return points + rng.normal(0, noise, (count, 1)) * normal, np.broadcast_to(normal, points.shape)


def test_walls_are_found_and_what_is_small_or_bent_or_level_is_not() -> None:
    rng = np.random.default_rng(0)
    level = np.column_stack([rng.uniform(0, 40, (4000, 2)), np.zeros(4000)]), np.tile([0.0, 0, 1], (4000, 1))
    angle = rng.uniform(0, 2 * np.pi, 3000)
    trunk = np.column_stack([20 + 0.3 * np.cos(angle), 5 + 0.3 * np.sin(angle), rng.uniform(0, 6, 3000)])
    round_ = trunk, np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    kerb, short = wall((0, 3), 0, 30, 0.15), wall((40, 0), 90, 3, 3)
    found = fitted_facades([level, round_, kerb, short, wall((0, 8), 0, 30, 6), wall((3, -6), 20, 12, 1.5)])
    assert len(found) == 2
    for (grid, size_m), length, height, ends in zip(
        found, (30, 12), (6, 1.5), (((0, 8), (30, 8)), ((3, -6), (14.28, -1.9))), strict=True
    ):
        assert np.abs(size_m - [length, height + FOOT_M]).max() < 0.6
        np.testing.assert_allclose(grid[:3, :3] @ grid[:3, :3].T, np.eye(3), atol=1e-9)
        assert np.linalg.det(grid[:3, :3]) > 0.99
        local = transform_points(grid, np.array([[*end, 0] for end in ends]))
        assert np.abs(local[:, 2]).max() < 0.1 and np.abs(np.sort(local[:, 0]) - [0, length]).max() < 0.3
        assert np.abs(local[:, 1] - FOOT_M).max() < 0.3


def test_gaps_part_walls_and_nothing_is_fitted_to_nothing() -> None:
    apart = fitted_facades([wall((0, 8), 0, 10, 5), wall((30, 8), 0, 14, 5)])
    assert sorted(float(size_m[0].round()) for _, size_m in apart) == [10, 14]
    together = fitted_facades([wall((0, 8), 0, 10, 5), wall((15, 8), 0, 14, 5)])
    assert len(together) == 1 and abs(together[0][1][0] - 29) < 0.5
    assert fitted_facades([(np.zeros((0, 3)), np.zeros((0, 3)))]) == []


def test_surfaces_of_a_view_face_it() -> None:
    azimuth, elevation = np.meshgrid(np.linspace(-0.5, 0.5, 41), np.linspace(-0.1, 0.2, 21))
    directions = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], -1
    )
    depth = (10 / directions[..., 0]).astype(np.float32)  # a wall across, ten metres ahead
    actor = np.zeros(depth.shape, np.int16)
    actor[:, :10] = 1
    depth[0], depth[:, 30:] = 0, 80
    view = DepthView(0.0, np.eye(4), None, 0.0, 0.0, *around(depth), actor)
    points, normals = surfaces_of(view, Rays(np.zeros_like(directions), directions, np.zeros(depth.shape)))
    assert len(points) == 19 * 19
    np.testing.assert_allclose(points[:, 0], 10, atol=0.02)
    flat = np.abs(points[:, 1]) < 1.9  # beside what is further away a normal leans
    assert flat.sum() > 200
    np.testing.assert_allclose(normals[flat], np.tile([-1.0, 0, 0], (flat.sum(), 1)), atol=0.1)
