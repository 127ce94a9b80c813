"""Fréchet inception distance of two sets of images, with a network whose weights the user gives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import UnisimError
from ..geometry import FloatArray


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
        import torch

        try:
            self.network: Any = torch.jit.load(path, map_location="cpu").eval()
        except (OSError, RuntimeError, ValueError) as error:
            raise UnisimError(f"{path}: is no TorchScript of Inception: {str(error).splitlines()[0]}") from error
        self.path = path

    def features(self, image: NDArray[np.uint8]) -> FloatArray:
        """Of an image (H, W, 3): (F,)."""
        import torch

        with torch.no_grad():
            try:
                out = self.network(torch.as_tensor(image.copy()).permute(2, 0, 1)[None], return_features=True)
            except RuntimeError as error:
                raise UnisimError(
                    f"{self.path}: gives no features of an image: {str(error).splitlines()[-1]}"
                ) from error
        return np.asarray(out.reshape(-1).double().numpy())
