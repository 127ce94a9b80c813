"""Where points are along a polyline and beside it, against places sampled along it."""

from __future__ import annotations

import math

import numpy as np
import pytest

from unisim_blender.core.world.polyline import Polyline, spaced

HAIRPIN = np.array([[0.0, 0], [30, 0], [33, 2], [30, 4], [0, 4]])


@pytest.mark.parametrize("seed", range(5))
def test_the_nearest_place_is_that_of_many_samples(seed: int) -> None:
    rng = np.random.default_rng([28, seed])
    points = np.cumsum(rng.normal(0, 3, (12, 2)), 0)
    first, last = rng.uniform(-4, 4, 2)
    before, after = (np.array([math.cos(angle), math.sin(angle)]) for angle in (first, last))
    line = Polyline.through(points, before, after)
    at = np.linspace(-80, line.length_m + 80, 40_001)
    samples = np.stack([np.interp(at, line.along_m, points[:, axis]) for axis in (0, 1)], -1)
    samples += np.minimum(at, 0)[:, None] * before + np.maximum(at - line.length_m, 0)[:, None] * after
    for x, y in rng.uniform(-20, 20, (40, 2)).tolist():
        away = np.hypot(samples[:, 0] - x, samples[:, 1] - y)
        found = line.project(x, y)
        assert found.away_m == pytest.approx(away.min(), abs=0.01)
        place = samples[np.argmin(np.abs(at - found.along_m))]
        assert np.hypot(*(place - [x, y])) == pytest.approx(found.away_m, abs=0.01)
        assert abs(found.left_m) <= found.away_m + 1e-9
        assert line.project(x, y, found.along_m) == found


def test_of_two_parts_the_one_near_is_taken() -> None:
    line = Polyline.through(HAIRPIN)
    assert line.project(10, 2.5).along_m > 30
    assert line.project(10, 2.5, 9.0)[:3] == pytest.approx((10, 2.5, 2.5))
    assert line.project(10, 2.5, line.length_m)[:3] == pytest.approx((line.length_m - 10, 1.5, 1.5))


def test_ends_that_do_not_go_on() -> None:
    line = Polyline.through(np.array([[0.0, 0], [10, 0]]))
    assert line.project(-3, 4)[:3] == pytest.approx((0, 4, 5))
    assert line.project(13, -4)[:3] == pytest.approx((10, -4, 5))
    assert Polyline.through(np.array([[1.0, 1]])).project(4, 5)[:3] == pytest.approx((0, 0, 5))


def test_points_that_are_spaced() -> None:
    points = np.array([[0.0, 0], [0.3, 0], [0.6, 0], [0.9, 0], [1.2, 0]])
    assert spaced(points, 0.5).tolist() == [0, 2, 4]
    assert spaced(points[:1], 0.5).tolist() == [0]
