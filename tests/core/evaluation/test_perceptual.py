"""LPIPS with weights whose distance is known by hand. No trained weights are part of this project."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from unisim_blender.core.errors import UnisimError
from unisim_blender.core.evaluation.perceptual import Lpips

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
