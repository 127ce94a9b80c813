"""LPIPS, the perceptual distance of two images (Zhang et al., "The unreasonable effectiveness of deep features as a
perceptual metric", CVPR 2018), and FID, the Fréchet inception distance of two sets of images. Their weights are files
that the user gives: none are part of this project.

The file of LPIPS is the state of the authors' ``lpips.LPIPS(net="alex")`` or ``net="vgg"``, version 0.1, as .safetensors or as
.pth read without unpickling anything but tensors: ``net.sliceS.N.weight`` and ``.bias`` of the backbone's convolutions,
where N is torchvision's number of the layer, and ``linS.model.1.weight`` of the five linear layers.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor

from ..errors import UnisimError
from ..geometry import FloatArray
from ..model.networks import read_tensors
from .metrics import ImageArray

SHIFT = (-0.030, -0.088, -0.188)
SCALE = (0.458, 0.448, 0.450)
EPSILON = 1e-10


@dataclass(frozen=True)
class Slice:
    """Layers up to a tapped activation: a max-pool (edge, 0: none) and convolutions
    (torchvision's number, stride, padding)."""

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
        self._state = read_tensors(path, "LPIPS")
        self._slices = BACKBONES["alex" if "net.slice5.10.weight" in self._state else "vgg"]
        channels = 3
        for number, part in enumerate(self._slices):
            for layer, _, _ in part.convolutions:
                name = f"net.slice{number + 1}.{layer}"
                channels = self._check(path, f"{name}.weight", None, channels, None, None)
                self._check(path, f"{name}.bias", channels)
            self._check(path, f"lin{number}.model.1.weight", 1, channels, 1, 1)

    def _check(self, path: Path, name: str, *shape: int | None) -> int:
        """Return a tensor's first edge. Raises `UnisimError` unless the tensor is there, of that shape
        (None: any edge)."""
        if name not in self._state:
            raise UnisimError(
                f"{path}: holds no {name}, so these are no LPIPS weights (AlexNet or VGG-16, version 0.1)"
            )
        tensor = self._state[name]
        fits = tensor.ndim == len(shape) and all(n in (None, m) for n, m in zip(shape, tensor.shape, strict=True))
        if not fits or tensor.dtype != torch.float32 or not tensor.isfinite().all():
            wanted = " x ".join("N" if n is None else str(n) for n in shape)
            raise UnisimError(
                f"{path}: {name} must be {wanted} finite float32 numbers, not {tuple(tensor.shape)} {tensor.dtype}"
            )
        return int(tensor.shape[0])

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


def frechet_distance(a: FloatArray, b: FloatArray) -> float:
    """Distance of two Gaussians with the means and covariances of features a (N, F) and b (M, F): |m_a - m_b|^2 +
    tr(C_a + C_b - 2 (C_a C_b)^(1/2)), Heusel et al., "GANs trained by a two time-scale update rule" (2017), eq. 6.

    NaN where a set has fewer than two members. The trace of the root is the nuclear norm of A B^T, where A^T A = C_a
    and B^T B = C_b: fewer images than features need no root of a large, singular matrix.
    """
    if min(len(a), len(b)) < 2:
        return float("nan")
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    mean = a.mean(0) - b.mean(0)
    centred = [(x - x.mean(0)) / np.sqrt(len(x) - 1) for x in (a, b)]
    traces = sum(float((x**2).sum()) for x in centred)
    root = float(np.linalg.svd(centred[0] @ centred[1].T, compute_uv=False).sum())
    return float(mean @ mean + traces - 2 * root)


class Inception:
    """Features of images by a TorchScript file of Inception-v3, as StyleGAN's authors publish it: bytes (N, 3, H, W)
    and ``return_features`` in, features (N, F) out. UnisimError where the file is none."""

    def __init__(self, path: Path) -> None:
        try:
            self.network: Any = torch.jit.load(path, map_location="cpu").eval()
        except (OSError, RuntimeError, ValueError) as error:
            raise UnisimError(f"{path}: is no TorchScript of Inception: {str(error).splitlines()[0]}") from error
        self.path = path

    def features(self, image: NDArray[np.uint8]) -> FloatArray:
        """Return the features (F,) of an image (H, W, 3)."""
        with torch.no_grad():
            try:
                out = self.network(torch.as_tensor(image.copy()).permute(2, 0, 1)[None], return_features=True)
            except RuntimeError as error:
                raise UnisimError(
                    f"{self.path}: gives no features of an image: {str(error).splitlines()[-1]}"
                ) from error
        return np.asarray(out.reshape(-1).double().numpy())
