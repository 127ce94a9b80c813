"""The perceptual term with VGG-16 features, from a weights file that the user gives."""

from __future__ import annotations

from pathlib import Path

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from ...errors import UnisimError
from ...model.files.network_weights import read_tensors

_LAYERS = (64, 64, 0, 128, 128, 0, 256, 256, 256, 0, 512, 512, 512)
"""Channels of VGG-16's convolutions up to relu4_3; 0 is a max-pool (Simonyan and Zisserman, 2015, table 1, D)."""
_TAPS = (2, 4, 7, 10)
"""Numbers of the convolutions whose outputs are compared: relu1_2, 2_2, 3_3, 4_3."""


class VggLoss(nn.Module):
    """Mean absolute difference of VGG-16 features of two images (B, 3, H, W) in 0..1.

    The file is torchvision's ``vgg16`` state (names ``features.N.weight``), as .safetensors or as .pth read without
    unpickling anything but tensors.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        state = read_tensors(path, "VGG")
        self.convolutions = nn.ModuleList()
        self.pool_before: list[bool] = []
        position, channels, pooled = 0, 3, False
        for width in _LAYERS:
            if width == 0:
                pooled, position = True, position + 1
                continue
            layer = nn.Conv2d(channels, width, 3, padding=1)
            for kind in ("weight", "bias"):
                name = f"features.{position}.{kind}"
                value = state.get(name)
                expected = getattr(layer, kind).shape
                if value is None or value.shape != expected:
                    raise UnisimError(f"{path}: {name} of VGG-16 is missing or not of shape {tuple(expected)}")
                getattr(layer, kind).data.copy_(value)
            self.convolutions.append(layer)
            self.pool_before.append(pooled)
            channels, pooled, position = width, False, position + 2
        self.requires_grad_(False)
        self.register_buffer("mean", torch.tensor([0.485, 0.456, 0.406]).view(1, 3, 1, 1))
        self.register_buffer("std", torch.tensor([0.229, 0.224, 0.225]).view(1, 3, 1, 1))

    mean: Tensor
    std: Tensor

    def features(self, image: Tensor) -> list[Tensor]:
        """Outputs of the compared layers."""
        x, out = (image - self.mean) / self.std, []
        for number, (layer, pool) in enumerate(zip(self.convolutions, self.pool_before, strict=True), start=1):
            x = F.relu(layer(F.max_pool2d(x, 2) if pool else x))
            if number in _TAPS:
                out.append(x)
        return out

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """The loss."""
        pairs = zip(self.features(a), self.features(b), strict=True)
        return torch.stack([(x - y).abs().mean() for x, y in pairs]).sum()
