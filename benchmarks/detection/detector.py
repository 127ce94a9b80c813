"""What the two detectors have in common: a network's maps, their targets, and the loss between them.

A network gives 1 + K maps on a coarse grid: the logit of "a vehicle's middle part is here", and K numbers from which
the box follows. Targets are class maps (h, w), 1 vehicle, 0 none, -1 not counted, and regression maps (K, h, w), used
where there is a vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from unisim_blender.core.evaluation.autonomy.document import IOU, without_duplicates
from unisim_blender.core.geometry import BoolArray, FloatArray

from .samples import Sample

LEAST_SCORE, MOST_BOXES, CANDIDATES = 0.05, 60, 300
_PRIOR = 0.01
"""Probability of a vehicle that an untrained network gives: without it the many empty cells would swamp
the first steps."""


@dataclass(frozen=True)
class Example:
    """input (C, H, W), classes (h, w) int8, regression (K, h, w)."""

    input: NDArray[np.float32]
    classes: NDArray[np.int8]
    regression: NDArray[np.float32]


class Detector(Protocol):
    """One of the two."""

    name: str
    kind: str
    """What its boxes are: of `unisim_blender.core.evaluation.autonomy.document.KINDS`."""
    overlap: float
    """Detections that overlap a better one by more than this IoU are duplicates."""

    def network(self) -> nn.Module:
        """An untrained network: (B, C, H, W) to (B, 1 + K, h, w)."""
        ...

    def example(self, sample: Sample, rng: np.random.Generator | None) -> Example:
        """A sample encoded; varied at random for training where there is a generator."""
        ...

    def boxes(self, regression: NDArray[np.float32], rows: NDArray[np.int64], columns: NDArray[np.int64]) -> FloatArray:
        """Boxes (N, 5 or 4) of cells (N,), (N,) of regression maps (K, h, w)."""
        ...

    def labels(self, sample: Sample) -> tuple[NDArray[np.float32], BoolArray]:
        """A sample's boxes and which of them need not be found."""
        ...


def decode(detector: Detector, maps: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
    """Boxes (N, 5 or 4), the best first, and scores (N,) of a network's maps (1 + K, h, w)."""
    scores = 1 / (1 + np.exp(-maps[0].astype(np.float64)))
    rows, columns = np.nonzero(scores >= LEAST_SCORE)
    best = np.argsort(-scores[rows, columns], kind="stable")[:CANDIDATES]
    rows, columns = rows[best], columns[best]
    boxes, score = detector.boxes(maps[1:], rows, columns), scores[rows, columns]
    kept = without_duplicates(IOU[detector.kind](boxes, boxes), score, detector.overlap)[:MOST_BOXES]
    return boxes[kept], score[kept]


def loss(maps: Tensor, classes: Tensor, regression: Tensor) -> tuple[Tensor, Tensor]:
    """Focal loss (Lin et al., ICCV 2017; gamma 2, alpha 0.25) of the class, smooth L1 of the boxes; both by
    vehicles' cells.

    maps (B, 1 + K, h, w), classes (B, h, w), regression (B, K, h, w).
    """
    vehicle = classes == 1
    count = vehicle.sum().clamp(min=1)
    truth = vehicle.float()
    error = F.binary_cross_entropy_with_logits(maps[:, 0], truth, reduction="none")
    wrong = 1 - torch.exp(-error)
    balance = 0.25 * truth + 0.75 * (1 - truth)
    focal = (balance * wrong**2 * error * (classes >= 0)).sum() / count
    away = F.smooth_l1_loss(maps[:, 1:], regression, reduction="none", beta=0.1).sum(1)
    return focal, (away * vehicle).sum() / count


def conv(before: int, after: int, stride: int = 1) -> nn.Sequential:
    """A convolution of 3 x 3, normalised by batch, with ReLU."""
    return nn.Sequential(
        nn.Conv2d(before, after, 3, stride, 1, bias=False), nn.BatchNorm2d(after), nn.ReLU(inplace=True)
    )


class Pyramid(nn.Module):
    """Stages that halve the resolution, and a way back up to a quarter of it (Lin et al., CVPR 2017), with the
    maps at its end.

    widths: channels at 1/2, 1/4, 1/8 and so on.
    """

    def __init__(self, channels: int, widths: tuple[int, ...], maps: int, features: int) -> None:
        super().__init__()
        self.stem = nn.Sequential(conv(channels, widths[0], 2), conv(widths[0], widths[0]))
        pairs = zip(widths[:-1], widths[1:], strict=True)
        self.stages = nn.ModuleList(nn.Sequential(conv(a, b, 2), conv(b, b)) for a, b in pairs)
        self.across = nn.ModuleList(nn.Conv2d(width, features, 1) for width in widths[1:])
        self.joined = conv(features, features)
        self.maps = nn.Conv2d(features, maps, 1)
        nn.init.normal_(self.maps.weight, std=0.01)
        bias = torch.zeros(maps)
        bias[0] = float(np.log(_PRIOR / (1 - _PRIOR)))
        self.maps.bias = nn.Parameter(bias)

    def forward(self, x: Tensor) -> Tensor:
        """(B, C, H, W) to (B, maps, H / 4, W / 4), rounded up."""
        x = self.stem(x)
        levels = []
        for stage in self.stages:
            x = stage(x)
            levels.append(x)
        joined = self.across[-1](levels[-1])
        for across, level in zip(list(self.across)[-2::-1], levels[-2::-1], strict=True):
            joined = across(level) + F.interpolate(joined, size=level.shape[-2:], mode="nearest")
        out: Tensor = self.maps(self.joined(joined))
        return out
