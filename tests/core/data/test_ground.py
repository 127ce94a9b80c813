"""Height of the ground from returns of ground, walls, slopes and roofs whose places are known."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from unisim_blender.core.data.ground import ground_heights, windows

SHAPE = (40, 40)


def _plain(height: NDArray[np.float64], rows: slice = slice(None)) -> NDArray[np.float64]:
    """Return nine returns (N, 3) of each cell of these rows along x, at the cells' heights (X, Y)."""
    x, y = np.meshgrid(
        np.arange(SHAPE[0] * 3)[rows.start and rows.start * 3 : rows.stop and rows.stop * 3], np.arange(SHAPE[1] * 3)
    )
    z = height[x.ravel() // 3, y.ravel() // 3]
    return np.stack([(x.ravel() + 0.5) / 3, (y.ravel() + 0.5) / 3, z], 1)


def _wall(x: float, foot: float, top: float) -> NDArray[np.float64]:
    """Return returns (N, 3) of a wall at x, from the height of its foot that is seen to its top."""
    y, z = np.meshgrid(np.arange(0.1, SHAPE[1], 0.25), np.arange(foot, top, 0.1))
    return np.stack([np.full(y.size, x), y.ravel(), z.ravel()], 1)


def _of(*points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    all_points = np.concatenate(points)
    return ground_heights(np.floor(all_points[:, :2]).astype(np.int64), all_points[:, 2], SHAPE)


@pytest.mark.parametrize("foot", [0.0, 0.3, 0.6, 1.5])
def test_a_wall_is_no_ground_wherever_what_is_seen_of_it_begins(foot: float) -> None:
    heights, trusted = _of(_plain(np.zeros(SHAPE), slice(0, 20 + (foot == 0))), _wall(20.5, foot, 6.0))
    assert np.abs(heights).max() < (0.11 if foot == 0 else 1e-6)  # the 5th percentile
    assert trusted[:20].all()
    assert not trusted[21:].any()
    assert trusted[20].all() == (foot == 0)


def test_a_slope_and_a_bank_at_the_edge_are_ground() -> None:
    across = np.arange(SHAPE[0])[:, None] + np.zeros(SHAPE)
    for height in (0.1 * across, 0.2 * np.clip(across - 20, 0, None)):
        heights, trusted = _of(_plain(height, slice(0, 25)))
        assert np.abs(heights - height)[2:19].max() < 1e-6
        assert np.abs(heights - height)[19:25].max() < 0.71  # the median of a kink, and of an end
        assert trusted[:25].all()


def test_a_tree_on_a_pavement_leaves_it_ground() -> None:
    crown = np.stack([np.full(400, 10.5), np.full(400, 10.5), np.linspace(2, 6, 400)], 1)
    heights, trusted = _of(_plain(np.zeros(SHAPE)), crown[:9])
    assert np.abs(heights).max() < 1e-6
    assert trusted.all()
    heights, trusted = _of(_plain(np.zeros(SHAPE)), crown)
    assert np.abs(heights).max() < 1e-6


def test_a_roof_is_no_ground() -> None:
    roof = np.zeros(SHAPE)
    roof[15:20, 15:20] = 5.0
    heights, trusted = _of(_plain(roof))
    assert np.abs(heights).max() < 1e-6
    assert not trusted[15:20, 15:20].any()


def test_where_everything_stands_the_lowest_returns_are_the_ground() -> None:
    heights, trusted = _of(_wall(20.5, 0.0, 3.0))
    assert heights == pytest.approx(0.1, abs=0.06)  # the 5th percentile
    assert trusted[20].all()


def test_without_returns_the_ground_is_level() -> None:
    heights, trusted = _of(np.zeros((0, 3)))
    assert not heights.any()
    assert not trusted.any()


@pytest.mark.parametrize("reduce", [np.min, np.max, np.median])
def test_windows_are_those_of_single_cells(reduce: object) -> None:
    assert callable(reduce)
    values = np.random.default_rng(0).normal(size=(9, 7))
    out, padded = windows(values, 5, reduce), np.pad(values, 2, mode="edge")
    for x in range(9):
        for y in range(7):
            assert out[x, y] == reduce(padded[x : x + 5, y : y + 5])
