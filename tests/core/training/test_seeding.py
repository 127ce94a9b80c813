"""What training takes from LiDAR before its first step, beside plain loops over rays."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.geometry import FloatArray, Trajectory, points_in_box
from unisim_blender.core.model.occupancy import BESIDE, FREE, HIT, UNKNOWN
from unisim_blender.core.training import seeding as module
from unisim_blender.core.training.batches.data import LidarData
from unisim_blender.core.training.seeding import seed_voxels
from unisim_blender.core.world.drive import Actor, Appearance

SHAPE, VOXEL_M = (40, 30, 12), 0.5


def rays(count: int) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(3)
    origins = np.array([3.0, 4.0, 2.0]) + rng.normal(0, 0.3, (count, 3))
    # some end outside of the volume, on either side of it
    return origins, rng.uniform([-4, -4, 0.2], [24, 19, 7], (count, 3))


def plainly(origins: FloatArray, points: FloatArray) -> FloatArray:
    def cell(x: FloatArray) -> tuple[int, ...] | None:
        at = np.floor(x / VOXEL_M).astype(int)
        return tuple(at) if (at >= 0).all() and (at < SHAPE).all() else None

    values = np.full(SHAPE, UNKNOWN)
    step = 0.75 * VOXEL_M
    for origin, point in zip(origins, points, strict=True):
        length = np.linalg.norm(point - origin)
        for t in np.arange(0.5 * step, min(length - 2 * VOXEL_M, module.FREE_UP_TO_M), step):
            if (at := cell(origin + (point - origin) * t / length)) is not None:
                values[at] = FREE
    hits = [at for point in points if (at := cell(point)) is not None]
    for x, y, z in hits:
        values[max(0, x - 1) : x + 2, max(0, y - 1) : y + 2, max(0, z - 1) : z + 2] = BESIDE
    for at in hits:
        values[at] = HIT
    return values


def test_voxels_are_those_of_single_rays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "_AT_ONCE", 7)
    origins, points = rays(60)
    nowhere = np.full((20, 15), -5.0, np.float32)
    values = seed_voxels(origins, points, SHAPE, VOXEL_M, nowhere, np.zeros((20, 15), bool))
    np.testing.assert_array_equal(values, plainly(origins, points))
    assert {HIT, BESIDE, FREE, UNKNOWN} == set(np.unique(values))


def test_no_ray_tells_of_anything() -> None:
    nothing = np.zeros((0, 3))
    ground = np.zeros((20, 15), np.float32)
    values = seed_voxels(nothing, nothing, SHAPE, VOXEL_M, ground - 5, np.zeros((20, 15), bool))
    assert (values == UNKNOWN).all()


def test_static_returns_are_those_in_no_box() -> None:
    rng = np.random.default_rng(5)
    count = 4000
    turned = np.array([np.cos(0.4), 0, 0, np.sin(0.4)])
    size_m = np.array([4.0, 2.0, 1.5])
    stand = Trajectory(np.array([1.0]), np.array([[5.0, 3.0, 0.5]]), turned[None])
    still = Actor("a", "Car", size_m, stand, 0.2, 0.7, False, Appearance("a"))
    keys = np.array([[0.0, -3.0, 0.5], [6.0, -3.0, 0.5], [9.0, 1.0, 0.5]])
    trajectory = Trajectory(np.array([0.1, 0.5, 0.9]), keys, np.array([[1.0, 0, 0, 0], [1.0, 0, 0, 0], turned]))
    moving = Actor("b", "Car", size_m, trajectory, 0.1, 0.9, True, Appearance("b"))
    data = object.__new__(LidarData)
    data.corner = np.array([-100.0, -50.0, 0.0])
    data.time_s = rng.uniform(0, 1, count)
    data.origins = (np.zeros((count, 3)) - data.corner).astype(np.float32)
    to = rng.uniform([-4, -6, 0], [14, 6, 1.5], (count, 3))
    data.depth_m = np.linalg.norm(to, axis=1)
    data.directions = (to / data.depth_m[:, None]).astype(np.float32)
    data.returned = rng.random(count) < 0.9
    data._hits = np.flatnonzero(data.returned)

    points, times = data.points, data.time_s[data._hits]
    inside = [
        any(
            actor.present(t) and points_in_box(p[None], actor.world_from_actor.at(t), np.asarray(actor.size_m) + 0.2)[0]
            for actor in (still, moving)
        )
        for p, t in zip(points, times, strict=True)
    ]
    assert 100 < sum(inside) < len(inside) - 100
    origins, static = data.static_returns([still, moving])
    np.testing.assert_array_equal(static, points[~np.array(inside)])
    assert origins.shape == static.shape
