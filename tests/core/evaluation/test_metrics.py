"""Metrics against values worked out by hand.

LPIPS is tested with weights whose distance is known by hand: no trained weights are part of this project.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.evaluation.lidar_metrics import lidar_metrics
from unisim_blender.core.evaluation.metrics import chamfer, mean_of, psnr, ssim
from unisim_blender.core.evaluation.perceptual import Lpips
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


SHAPES = {
    "alex": {
        "slice1.0": (64, 3, 11),
        "slice2.3": (192, 64, 5),
        "slice3.6": (384, 192, 3),
        "slice4.8": (256, 384, 3),
        "slice5.10": (256, 256, 3),
    },
    "vgg": {
        **{"slice1.0": (64, 3, 3), "slice1.2": (64, 64, 3), "slice2.5": (128, 64, 3), "slice2.7": (128, 128, 3)},
        **{"slice3.10": (256, 128, 3), "slice3.12": (256, 256, 3), "slice3.14": (256, 256, 3)},
        **{"slice4.17": (512, 256, 3), "slice4.19": (512, 512, 3), "slice4.21": (512, 512, 3)},
        **{"slice5.24": (512, 512, 3), "slice5.26": (512, 512, 3), "slice5.28": (512, 512, 3)},
    },
}


def zero_state(net: str) -> dict[str, Tensor]:
    """Weights that are all 0, in the shapes and under the names of the authors' file."""
    state, channels = {}, {}
    for name, (out, into, edge) in SHAPES[net].items():
        state[f"net.{name}.weight"] = torch.zeros(out, into, edge, edge)
        state[f"net.{name}.bias"] = torch.zeros(out)
        channels[int(name[5]) - 1] = out
    return state | {f"lin{i}.model.1.weight": torch.zeros(1, n, 1, 1) for i, n in channels.items()}


def test_distance_of_constant_images(tmp_path: Path) -> None:
    """One feature is red as it enters the network, one is 1: the distance of their unit vectors,
    weighted by 2, is known."""
    state = zero_state("alex")
    state["net.slice1.0.weight"][0, 0, 5, 5] = 1
    state["net.slice1.0.bias"][1] = 1
    state["lin0.model.1.weight"][:] = 2
    save_file(state, tmp_path / "alex.safetensors")
    a, b = np.full((64, 64, 3), 0.9, np.float32), np.full((64, 64, 3), 0.6, np.float32)
    red = [(2 * value - 1 + 0.030) / 0.458 for value in (0.9, 0.6)]
    unit = [np.array([r, 1]) / np.hypot(r, 1) for r in red]
    assert Lpips(tmp_path / "alex.safetensors")(a, b) == pytest.approx(2 * ((unit[0] - unit[1]) ** 2).sum(), rel=1e-5)


@pytest.mark.parametrize("net", ["alex", "vgg"])
def test_equal_images_have_no_distance(net: str, tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(0)
    state = {name: torch.rand(value.shape, generator=generator) * 0.1 for name, value in zero_state(net).items()}
    torch.save(state, tmp_path / "weights.pth")
    distance = Lpips(tmp_path / "weights.pth")
    image = np.random.default_rng(0).random((64, 64, 3)).astype(np.float32)
    assert distance(image, image) == 0
    assert distance(image, image[::-1]) > 0


def test_other_files_are_refused(tmp_path: Path) -> None:
    state = zero_state("alex")
    del state["lin3.model.1.weight"]
    save_file(state, tmp_path / "part.safetensors")
    with pytest.raises(UnisimError, match="part.safetensors: holds no lin3"):
        Lpips(tmp_path / "part.safetensors")
    (tmp_path / "words.pth").write_text("no weights")
    with pytest.raises(UnisimError, match="words.pth"):
        Lpips(tmp_path / "words.pth")
    torch.save({"run": print}, tmp_path / "hostile.pth")
    with pytest.raises(UnisimError, match="hostile.pth"):
        Lpips(tmp_path / "hostile.pth")
    with pytest.raises(UnisimError, match="gone.pth"):
        Lpips(tmp_path / "gone.pth")
