"""Perceptual distance of two images (Zhang et al., "The unreasonable effectiveness of deep features as a perceptual metric",
CVPR 2018), with weights from a file that the user gives: none are part of this project.

The file is the state of the authors' ``lpips.LPIPS(net="alex")`` or ``net="vgg"``, version 0.1, as .safetensors or as .pth read
without unpickling anything but tensors: ``net.sliceS.N.weight`` and ``.bias`` of the backbone's convolutions, where N is
torchvision's number of the layer, and ``linS.model.1.weight`` of the five linear layers.
"""

from __future__ import annotations

import pickle
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from safetensors import SafetensorError
from safetensors.torch import load_file
from torch import Tensor

from ..errors import UnisimError
from .metrics import ImageArray

SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
EPSILON = 1e-10


@dataclass(frozen=True)
class Slice:
    """Layers up to a tapped activation: a max-pool (edge, 0: none) and convolutions (torchvision's number, stride, padding)."""

    pool: int
    convolutions: tuple[tuple[int, int, int], ...]


BACKBONES: dict[str, tuple[Slice, ...]] = {
    "alex": (
        Slice(0, ((0, 4, 2),)),
        Slice(3, ((3, 1, 2),)),
        Slice(3, ((6, 1, 1),)),
        Slice(0, ((8, 1, 1),)),
        Slice(0, ((10, 1, 1),)),
    ),
    "vgg": (
        Slice(0, ((0, 1, 1), (2, 1, 1))),
        Slice(2, ((5, 1, 1), (7, 1, 1))),
        Slice(2, ((10, 1, 1), (12, 1, 1), (14, 1, 1))),
        Slice(2, ((17, 1, 1), (19, 1, 1), (21, 1, 1))),
        Slice(2, ((24, 1, 1), (26, 1, 1), (28, 1, 1))),
    ),
}


class Lpips:
    """The distance of images (H, W, 3), sRGB in 0..1, of at least 64 x 64 pixels."""

    def __init__(self, path: Path) -> None:
        """Read the weights; which backbone they are of follows from their names. Raises `UnisimError`."""
        self._state = _read(path)
        self._slices = BACKBONES["alex" if "net.slice5.10.weight" in self._state else "vgg"]
        for number, part in enumerate(self._slices):
            names = [f"net.slice{number + 1}.{layer}.{kind}" for layer, _, _ in part.convolutions for kind in ("weight", "bias")]
            for name in (*names, f"lin{number}.model.1.weight"):
                if name not in self._state:
                    raise UnisimError(f"{path}: holds no {name}, so these are no LPIPS weights (AlexNet or VGG-16, version 0.1)")

    @torch.no_grad()
    def __call__(self, rendered: ImageArray, recorded: ImageArray) -> float:
        """The distance, 0 for equal images."""
        total = 0.0
        for number, (a, b) in enumerate(zip(self._features(rendered), self._features(recorded), strict=True)):
            weight = self._state[f"lin{number}.model.1.weight"]
            total += float(F.conv2d((_unit(a) - _unit(b)) ** 2, weight).mean())
        return total

    def _features(self, image: ImageArray) -> list[Tensor]:
        x = torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None] * 2 - 1
        x = (x - torch.tensor(SHIFT).view(1, 3, 1, 1)) / torch.tensor(SCALE).view(1, 3, 1, 1)
        out = []
        for number, part in enumerate(self._slices):
            if part.pool:
                x = F.max_pool2d(x, part.pool, 2)
            for layer, stride, padding in part.convolutions:
                name = f"net.slice{number + 1}.{layer}"
                x = F.relu(F.conv2d(x, self._state[f"{name}.weight"], self._state[f"{name}.bias"], stride, padding))
            out.append(x)
        return out


def _unit(features: Tensor) -> Tensor:
    """Features (1, C, H, W) of length 1 at every place."""
    return features / (features.square().sum(1, keepdim=True).sqrt() + EPSILON)


def _read(path: Path) -> dict[str, Tensor]:
    try:
        if path.suffix == ".safetensors":
            return dict(load_file(path))
        state = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, SafetensorError, RuntimeError, ValueError, EOFError, pickle.UnpicklingError) as error:
        raise UnisimError(f"{path}: LPIPS weights cannot be read: {str(error).splitlines()[0]}") from error
    if not isinstance(state, dict) or not all(isinstance(value, Tensor) for value in state.values()):
        raise UnisimError(f"{path}: holds something else than named tensors, so these are no LPIPS weights")
    return state
