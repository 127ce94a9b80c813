"""Metrics against values worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from unisim_blender.core.evaluation.metrics import chamfer, lidar_metrics, mean_of, psnr, ssim
from unisim_blender.core.geometry import FloatArray


def test_psnr_of_a_constant_offset() -> None:
    recorded = np.full((8, 8, 3), 0.4, np.float32)
    assert psnr(recorded + np.float32(0.1), recorded) == pytest.approx(20.0, abs=1e-4)
    assert psnr(recorded, recorded) == float("inf")


def test_psnr_within_a_mask() -> None:
    recorded = np.zeros((4, 4, 3), np.float32)
    rendered = recorded.copy()
    rendered[0, 0] = 1.0
    mask = np.zeros((4, 4), bool)
    mask[0, :2] = True
    assert psnr(rendered, recorded, mask) == pytest.approx(-10 * np.log10(1 / 2))
    assert psnr(rendered, recorded, ~mask) == float("inf")
    assert np.isnan(psnr(rendered, recorded, np.zeros((4, 4), bool)))


def gaussian_ssim(a: FloatArray, b: FloatArray) -> float:
    """SSIM by plain loops over 11 x 11 windows of one channel."""
    offset = np.arange(-5, 6)
    window = np.exp(-(offset[:, None] ** 2 + offset[None] ** 2) / (2 * 1.5**2))
    window /= window.sum()
    values = []
    for row in range(5, a.shape[0] - 5):
        for column in range(5, a.shape[1] - 5):
            x = a[row - 5 : row + 6, column - 5 : column + 6]
            y = b[row - 5 : row + 6, column - 5 : column + 6]
            mean_x, mean_y = (window * x).sum(), (window * y).sum()
            var_x, var_y = (window * x * x).sum() - mean_x**2, (window * y * y).sum() - mean_y**2
            covariance = (window * x * y).sum() - mean_x * mean_y
            values.append(
                (2 * mean_x * mean_y + 0.01**2)
                * (2 * covariance + 0.03**2)
                / ((mean_x**2 + mean_y**2 + 0.01**2) * (var_x + var_y + 0.03**2))
            )
    return float(np.mean(values))


def test_ssim_is_the_papers() -> None:
    rng = np.random.default_rng(0)
    recorded = rng.random((16, 18, 3)).astype(np.float32)
    rendered = np.clip(recorded + rng.normal(0, 0.2, recorded.shape), 0, 1).astype(np.float32)
    expected = np.mean(
        [gaussian_ssim(recorded[..., c].astype(float), rendered[..., c].astype(float)) for c in range(3)]
    )
    assert ssim(rendered, recorded) == pytest.approx(expected, abs=1e-6)
    assert np.isnan(ssim(rendered[:8], recorded[:8]))


def test_chamfer_of_three_points() -> None:
    recorded = np.array([[0.0, 0, 0], [10, 0, 0]])
    rendered = np.array([[0.0, 3, 0]])
    # there: 3; back: 3 and sqrt(109)
    found = chamfer(rendered, recorded)
    assert found["chamfer_m"] == pytest.approx((3 + (3 + np.sqrt(109)) / 2) / 2)
    assert found["chamfer_squared_m2"] == pytest.approx((9 + 9 + 109) / 2)
    assert np.isnan(chamfer(rendered[:0], recorded)["chamfer_m"])


def test_lidar_metrics_of_six_rays() -> None:
    returned = np.array([True, True, True, False, False, True])
    recorded_returned = np.array([True, True, True, True, False, False])
    depth = np.array([10.0, 20.1, 31.0, 5.0, 5.0, 5.0], np.float32)
    recorded_depth = np.array([10.0, 20.0, 30.0, 40.0, 0.0, 0.0], np.float32)
    intensity = np.array([0.5, 0.5, 0.8, 0.9, 0.9, 0.9], np.float32)
    recorded_intensity = np.array([0.5, 0.5, 0.5, 0.0, 0.0, 0.0], np.float32)
    found = lidar_metrics(depth, intensity, returned, recorded_depth, recorded_intensity, recorded_returned)
    assert found["depth_median_m"] == pytest.approx(0.1, abs=1e-6)
    assert found["depth_p90_m"] == pytest.approx(0.1 + 0.8 * 0.9, abs=1e-5)
    assert found["depth_mean_m"] == pytest.approx(1.1 / 3, abs=1e-6)
    assert found["depth_median_squared_m2"] == pytest.approx(0.01, abs=1e-6)
    assert found["hit_rate"] == pytest.approx(3 / 4)
    assert found["drop_accuracy"] == pytest.approx(4 / 6)
    assert found["intensity_rmse"] == pytest.approx(np.sqrt(0.09 / 3), abs=1e-6)


def test_lidar_metrics_without_returns() -> None:
    none, zero = np.zeros(3, bool), np.zeros(3, np.float32)
    found = lidar_metrics(zero, zero, none, zero, zero, none)
    assert np.isnan(found["depth_median_m"]) and np.isnan(found["hit_rate"]) and found["drop_accuracy"] == 1


def test_mean_leaves_out_what_is_not_there() -> None:
    assert mean_of([{"a": 1.0}, {"a": float("nan")}, {"a": float("inf")}, {"b": 2.0}, {"a": 3.0}], "a") == 2.0
    assert mean_of([{"a": None}], "a") is None
